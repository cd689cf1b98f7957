"""Stacked learners that update many runs at once."""
