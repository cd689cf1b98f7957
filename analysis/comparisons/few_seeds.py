"""The caveat of results with few seeds, the same in every view."""

from __future__ import annotations

from typing import Final

FEW_SEEDS: Final = 10
"""Under this many seeds a sentence warns the reader; the paper used 16 to 48."""


def in_brief(smallest: float) -> str:
    """Returns what a sentence on tests adds of a group with `smallest` runs: ``; few seeds``, or nothing."""
    return "; few seeds" if smallest < FEW_SEEDS else ""


def caveat(smallest: float) -> str:
    """Returns a sentence for readers of results of which one has no more than `smallest` runs, or nothing."""
    if not smallest < FEW_SEEDS:
        return ""
    seeds = f"{smallest:.0f} seed{'s' if smallest > 1 else ''}"
    return (
        f"With no more than {seeds} only large differences can show, and their size is uncertain; "
        f"take this as an indication, not as a result."
    )
