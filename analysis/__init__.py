"""Reads results: measures, statistics, figures, and a report in one page."""
