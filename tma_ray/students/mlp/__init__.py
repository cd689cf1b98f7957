"""Multilayer perceptrons of all students, importable without torch."""
