"""Tests, intervals, corrections and power: one function for each question, over arrays and series."""

from analysis.statistics.comparisons import (
    Comparison,
    Method,
    standard_error_of_difference,
    stratified,
    welch,
    welch_from_statistics,
)
from analysis.statistics.corrections import holm
from analysis.statistics.pairing import paired, paired_strata
from analysis.statistics.samples import CONFIDENCE, SIGNIFICANCE, Description, describe, mean_interval

__all__ = [
    "CONFIDENCE",
    "SIGNIFICANCE",
    "Comparison",
    "Description",
    "Method",
    "describe",
    "holm",
    "mean_interval",
    "paired",
    "paired_strata",
    "standard_error_of_difference",
    "stratified",
    "welch",
    "welch_from_statistics",
]
