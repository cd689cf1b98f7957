"""Multilayer perceptrons of all students, imported without torch."""
