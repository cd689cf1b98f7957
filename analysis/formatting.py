"""Numbers as a reader expects them, and warnings where they rest on few."""

import math
from collections.abc import Iterable

LISTED, FIRST = 12, 6
"""Up to so many names are all listed; of more so many."""

FEW_SEEDS = 10
"""Number of seeds under which a sentence warns the reader; the paper used 16 to 48."""


def number(value: float, digits: int = 1) -> str:
    """Return `value` with a true minus sign, or a dash where there is none."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def plus_minus(mean: float, std: float, digits: int = 1) -> str:
    """Return ``mean ± standard deviation``, the mean alone where one seed has no deviation."""
    if not math.isfinite(std):
        return number(mean, digits)
    return f"{number(mean, digits)} ± {number(std, digits)}"


def ends(low: float, high: float, digits: int = 1) -> str:
    """Return an interval as ``[1.0, 2.5]``, or a note that the runs have no spread."""
    if not math.isfinite(low):
        return "[no spread]"
    return f"[{number(low, digits)}, {number(high, digits)}]"


def estimate(value: float, low: float, high: float, digits: int = 1) -> str:
    """Return ``2.0 [1.0, 2.5]``, the value alone where runs have no spread for an interval."""
    if not math.isfinite(low):
        return number(value, digits)
    return f"{number(value, digits)} {ends(low, high, digits)}"


def p_value(p: float) -> str:
    """Return ``p = 0.012`` or ``p < 0.001``."""
    return "p\N{NO-BREAK SPACE}< 0.001" if p < 0.001 else f"p = {p:.3f}"


def amount(steps: float) -> str:
    """Return a number of steps in words: ``20 million``, ``30 thousand``, ``500``."""
    for size, word in ((1e6, "million"), (1e3, "thousand")):
        if steps >= size:
            return f"{steps / size:.4g} {word}"
    return f"{steps:.0f}"


def duration(seconds: float) -> str:
    """Return a length of time in a unit that suits it: ``12 s``, ``34 minutes``, ``5.6 hours``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.1f} hours"


def listed(names: Iterable[str]) -> str:
    """Return names separated by commas; of a long list the first ones, and how many more there are."""
    found = list(names)
    if len(found) <= LISTED:
        return ", ".join(found)
    return f"{', '.join(found[:FIRST])} and {len(found) - FIRST} more"


def in_brief(smallest: float) -> str:
    """Return the end of a sentence on tests with `smallest` runs in a group: ``; few seeds``, or nothing."""
    return "; few seeds" if smallest < FEW_SEEDS else ""


def caveat(smallest: float) -> str:
    """Return a warning on results with as few as `smallest` runs, or nothing."""
    if not smallest < FEW_SEEDS:
        return ""
    seeds = f"{smallest:.0f} seed{'s' if smallest > 1 else ''}"
    return (
        f"With as few as {seeds} only large differences can show, and their size is uncertain; "
        f"take this as an indication, not as a result."
    )
