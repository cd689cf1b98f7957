"""Statistical tests, confidence intervals, corrections for multiple testing, and power."""

from analysis.statistics.samples import (
    CONFIDENCE,
    SIGNIFICANCE,
    Description,
    describe,
    holm,
    mean_interval,
    mean_percent_interval,
    percent_interval,
)
from analysis.statistics.tests import (
    Comparison,
    Method,
    Scale,
    least_variance,
    paired,
    paired_strata,
    simultaneous_intervals,
    standard_error_of_difference,
    stratified,
    stratum_weights,
    welch,
    welch_from_statistics,
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
    "least_variance",
    "mean_interval",
    "mean_percent_interval",
    "paired",
    "paired_strata",
    "percent_interval",
    "simultaneous_intervals",
    "standard_error_of_difference",
    "stratified",
    "stratum_weights",
    "welch",
    "welch_from_statistics",
]
