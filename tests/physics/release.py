"""The original release's measured behaviour (tests/reference/behaviour.csv) under our names of bodies."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

BEHAVIOUR = Path(__file__).parents[1] / "reference" / "behaviour.csv"

FAST = ("classic_bipedal", "climbing_chimpanzee", "fish")
"""Bodies whose behaviour the fast tier measures."""


class Statistics(NamedTuple):
    """Statistics of one figure over `n` repetitions; the standard deviation is the population's."""

    n: int
    mean: float
    std: float


def measured(protocol: str, environment: str, embodiment: str, case: str = "") -> dict[str, Statistics]:
    """Return the release's statistics of one body under one protocol, by figure.

    Raises:
        KeyError: nothing of the kind was measured.
    """
    return _behaviour()[protocol, environment, embodiment, case]


def bodies(*names: str) -> list[Any]:
    """Return values of a test's parameter: bodies, those outside the fast tier marked as slow."""
    return [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in names]


@cache
def _behaviour() -> dict[tuple[str, ...], dict[str, Statistics]]:
    table: dict[tuple[str, ...], dict[str, Statistics]] = {}
    with BEHAVIOUR.open(newline="") as file:
        for row in csv.DictReader(file):
            key = row["protocol"], row["environment"], row["embodiment"], row["case"]
            statistics = Statistics(int(row["n"]), float(row["mean"]), float(row["std"]))
            table.setdefault(key, {})[row["figure"]] = statistics
    return table
