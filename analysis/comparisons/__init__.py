"""Comparisons of teachers: tests over pooled runs, rankings, findings, and results from several sources."""
