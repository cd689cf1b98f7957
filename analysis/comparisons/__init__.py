"""Comparisons of teachers: tests over pooled runs, rankings, findings, and results set side by side."""
