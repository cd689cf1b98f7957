"""Comparisons of teachers: tests over pooled runs, rankings, findings, and several sources of results."""
