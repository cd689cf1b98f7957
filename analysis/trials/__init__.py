"""Trials of a new teacher: a design fixed beforehand, verdicts at its looks, and what they are worth."""
