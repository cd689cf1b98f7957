"""Trials of new teachers against releases: designs, interim looks and verdicts."""
