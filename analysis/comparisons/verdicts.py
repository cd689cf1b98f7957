"""Verdicts of tests, and their combination over both measures (over training, at the end)."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final

import pandas as pd

from analysis.measures.tested import FINAL, HEADLINE, MARGINS
from analysis.statistics import SIGNIFICANCE
from analysis.statistics.samples import DEFAULT_MARGIN


class Verdict(StrEnum):
    """Result of a test after the correction for its family.

    Attributes:
        BETTER: significant difference over 0.
        WORSE: significant difference under 0.
        ALIKE: simultaneous interval within the margin.
        OPEN: none of these.
    """

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "alike"
    OPEN = "not distinguishable"


THAN: Final = {
    Verdict.BETTER: "better than",
    Verdict.WORSE: "worse than",
    Verdict.ALIKE: "alike, within the margin, with",
    Verdict.OPEN: "not distinguishable from",
}
"""Words of verdicts before the name of the other teacher."""

AXES: Final = {HEADLINE: "sooner", FINAL: "in the end"}
"""Axes by which teachers are compared, by measure: mean over training, and last three evaluations."""


def verdict(test: pd.Series | Mapping[str, Any]) -> str:
    """Return the `Verdict` of a row of `pairwise.pairwise`, or the reason for no test."""
    if test["reason"]:
        return str(test["reason"])
    if test["holm"] < SIGNIFICANCE:
        return Verdict.BETTER if test["difference"] > 0 else Verdict.WORSE
    margin = MARGINS.get(test["measure"], DEFAULT_MARGIN)
    within = -margin < test["simultaneous_low"] and test["simultaneous_high"] < margin
    return Verdict.ALIKE if within else Verdict.OPEN


def on_both_axes(sooner: str, in_the_end: str) -> str:
    """Return the combined verdict of both measures as text: plain "better" or "worse" if they agree.

    Args:
        sooner: verdict on the mean over training.
        in_the_end: verdict on the mean of the last three evaluations.

    Examples:
        >>> on_both_axes("better", "better"), on_both_axes("better", "alike"), on_both_axes("alike", "worse")
        ('better', 'sooner, and alike in the end', 'worse in the end only')
    """
    if sooner == in_the_end:
        return in_the_end
    when = {"better": "sooner", "worse": "later"}.get(sooner)
    decided = in_the_end in (Verdict.BETTER, Verdict.WORSE)
    if when is None:
        return f"{in_the_end} in the end only" if decided else str(Verdict.OPEN)
    return f"{when}, {'but' if decided else 'and'} {in_the_end} in the end"
