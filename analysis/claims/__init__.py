"""Tests of the paper's claims on results, and agreement of rankings."""
