"""Stacked learners, which update many runs at once."""
