"""Tests, intervals, corrections and power: one function for each question, over arrays and series."""

from analysis.statistics.comparisons import (
    Comparison,
    standard_error_of_difference,
    stratified,
    welch,
    welch_from_statistics,
)
from analysis.statistics.corrections import holm
from analysis.statistics.samples import CONFIDENCE, SIGNIFICANCE, Description, describe, mean_interval

__all__ = [
    "CONFIDENCE",
    "SIGNIFICANCE",
    "Comparison",
    "Description",
    "describe",
    "holm",
    "mean_interval",
    "standard_error_of_difference",
    "stratified",
    "welch",
    "welch_from_statistics",
]
