"""Bars of results, with every significant difference between two teachers."""
