"""Tests, intervals, corrections and power: one function for each question, over arrays and series."""

from analysis.statistics.comparisons import (
    Comparison,
    Method,
    Scale,
    standard_error_of_difference,
    stratified,
    tested_on,
    welch,
    welch_from_statistics,
)
from analysis.statistics.corrections import holm
from analysis.statistics.pairing import paired, paired_strata
from analysis.statistics.samples import (
    CONFIDENCE,
    SIGNIFICANCE,
    Description,
    describe,
    mean_interval,
    mean_percent_interval,
    percent_interval,
)

__all__ = [
    "CONFIDENCE",
    "SIGNIFICANCE",
    "Comparison",
    "Description",
    "Method",
    "Scale",
    "describe",
    "holm",
    "mean_interval",
    "mean_percent_interval",
    "paired",
    "paired_strata",
    "percent_interval",
    "standard_error_of_difference",
    "stratified",
    "tested_on",
    "welch",
    "welch_from_statistics",
]
