"""Measures of runs, and pools of runs behind results."""
