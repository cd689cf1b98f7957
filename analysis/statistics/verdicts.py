"""Verdicts by an interval against a margin: no significant difference alone supports nothing."""

from __future__ import annotations

from enum import StrEnum

MARGIN = 5.0
"""Points of mastered tasks under which a difference does not matter."""


class Standing(StrEnum):
    """Standing of a statement beside results.

    Attributes:
        SUPPORTED: the interval leaves no doubt of it.
        REFUTED: the interval leaves no doubt of its contrary.
        UNDECIDED: the interval allows for both.
        NO_DATA: complete results to hold it against are missing.
    """

    SUPPORTED = "supported"
    REFUTED = "refuted"
    UNDECIDED = "undecided"
    NO_DATA = "no data"


CONTRARY = {Standing.SUPPORTED: Standing.REFUTED, Standing.REFUTED: Standing.SUPPORTED}


def contrary(standing: Standing) -> Standing:
    """Returns the standing of a statement's negation."""
    return CONTRARY.get(standing, standing)


def greater(low: float, high: float, margin: float = MARGIN) -> Standing:
    """Returns the standing of "the difference is over 0", by its interval.

    Supported where the whole interval is over 0; else refuted where it is under `margin`, so that a
    difference that matters is ruled out. An interval of NaN decides nothing.

    Args:
        low: lower end of the interval.
        high: upper end of it.
        margin: the smallest difference that matters.
    """
    if low > 0:
        return Standing.SUPPORTED
    return Standing.REFUTED if high < margin else Standing.UNDECIDED


def equivalent(low: float, high: float, margin: float = MARGIN) -> Standing:
    """Returns the standing of "the difference does not matter", by the interval of the difference.

    Supported where the interval is within plus and minus `margin`; else refuted where it leaves out 0. An
    interval of NaN decides nothing.

    Args:
        low: lower end of the interval.
        high: upper end of it.
        margin: the smallest difference that matters.
    """
    if -margin < low and high < margin:
        return Standing.SUPPORTED
    return Standing.REFUTED if low > 0 or high < 0 else Standing.UNDECIDED
