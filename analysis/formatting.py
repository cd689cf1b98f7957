"""Formatting of numbers, intervals and lists, and warnings about few seeds."""

import math
from collections.abc import Iterable

from tma_ray.support.texts import counted

LISTED, FIRST = 12, 6  # of more than `LISTED` names, only the first `FIRST` are shown

FEW_SEEDS = 10  # readers are warned of fewer seeds; the paper used 16 to 48


def number(value: float, digits: int = 1) -> str:
    """Format a number with a typographic minus sign, or return a dash if it is not finite."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def plus_minus(mean: float, std: float, digits: int = 1) -> str:
    """Return ``mean ± standard deviation``, or the mean alone if the deviation is missing."""
    if not math.isfinite(std):
        return number(mean, digits)
    return f"{number(mean, digits)} ± {number(std, digits)}"


def interval_text(low: float, high: float, digits: int = 1) -> str:
    """Return an interval as ``[1.0, 2.5]``, or a note if the runs have no spread."""
    if not math.isfinite(low):
        return "[no spread]"
    return f"[{number(low, digits)}, {number(high, digits)}]"


def estimate(value: float, low: float, high: float, digits: int = 1) -> str:
    """Return a value with its interval, ``2.0 [1.0, 2.5]``, or alone if the runs have no spread."""
    if not math.isfinite(low):
        return number(value, digits)
    return f"{number(value, digits)} {interval_text(low, high, digits)}"


def p_value(p: float) -> str:
    """Format a p-value, such as ``p = 0.012`` or ``p < 0.001``."""
    return "p\N{NO-BREAK SPACE}< 0.001" if p < 0.001 else f"p = {p:.3f}"


def steps_text(steps: float) -> str:
    """Format a number of steps, such as ``20 million``, ``30 thousand`` or ``500``."""
    for size, word in ((1e6, "million"), (1e3, "thousand")):
        if steps >= size:
            return f"{steps / size:.4g} {word}"
    return f"{steps:.0f}"


def listed(names: Iterable[str]) -> str:
    """Join names by commas, shortening a long list so that it ends with ``and 8 more``."""
    texts = list(names)
    if len(texts) <= LISTED:
        return ", ".join(texts)
    return f"{', '.join(texts[:FIRST])} and {len(texts) - FIRST} more"


def few_seeds_suffix(smallest: float) -> str:
    """Return ``; few seeds`` if the smallest group of a test has few runs, else an empty string."""
    return "; few seeds" if smallest < FEW_SEEDS else ""


def few_seeds_warning(smallest: float) -> str:
    """Return a warning if the smallest group of a test has few runs, else an empty string."""
    if not smallest < FEW_SEEDS:
        return ""
    return (
        f"With as few as {counted(round(smallest), 'seed')} only large differences can show, and their size "
        f"is uncertain; take this as an indication, not as a result."
    )
