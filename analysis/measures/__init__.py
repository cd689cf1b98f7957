"""Measures of runs, computed from their evaluations and training, and the pools that runs make up."""
