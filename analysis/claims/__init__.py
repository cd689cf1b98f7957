"""Standings of the paper's claims by results, and agreement of rankings."""
