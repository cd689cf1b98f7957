"""Soft actor-critic. Importing this package imports no torch."""
