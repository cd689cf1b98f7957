"""Tests of the paper's claims against results, and agreement of rankings."""
