"""Costs of a plan before anything runs: measured speed, hours, disk and memory."""
