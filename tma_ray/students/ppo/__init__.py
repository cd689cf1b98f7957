"""Proximal policy optimisation. Importing this package imports no torch."""
