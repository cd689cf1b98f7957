"""The progress of campaigns: published by drivers, shown from any machine."""
