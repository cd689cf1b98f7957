"""Compiled engine, which calls Chipmunk's C functions from numba."""
