"""Measures of runs, and the pools of runs behind results."""
