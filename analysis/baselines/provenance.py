"""Machines and software that runs were made with, in words."""

from __future__ import annotations

from typing import Any, Final

import pandas as pd

from analysis.data.specs import parsed
from analysis.formatting import duration

LIBRARIES: Final = ("python", "tma_ray", "torch", "numpy", "pymunk")
"""Entries of a fingerprint that the card of a release shows."""


def made_on(attempts: pd.DataFrame) -> str:
    """Returns how many attempts there were, for how long, on which processors and with which software.

    Args:
        attempts: table of attempts, at least one.
    """
    hosts = attempts["host"].astype(str)
    machines = f", on machines: {hosts[hosts != ''].nunique()}" if (hosts != "").any() else ""
    hours = float(attempts["wall_seconds"].sum())
    text = f"Attempts: {len(attempts):,}{machines}, for {duration(hours)} together."
    prints = [parsed(str(each)) for each in attempts["fingerprint"].unique()]
    processors = _values(prints, "cpu")
    if processors:
        text += f" Processors: {', '.join(processors)}; devices: {', '.join(_devices(prints))}."
    versions = [f"{name} {', '.join(_values(prints, name))}" for name in LIBRARIES if _values(prints, name)]
    return f"{text} Software: {'; '.join(versions)}." if versions else text


def _devices(prints: list[dict[str, Any]]) -> list[str]:
    """Returns each device, with the model of a GPU and the width of a cohort."""
    shown = set()
    for each in prints:
        text = str(each.get("device", "cpu"))
        if "gpu" in each:
            text += f" ({each['gpu']})"
        if "cohort" in each:
            text += f" in cohorts of {each['cohort']}"
        shown.add(text)
    return sorted(shown)


def _values(prints: list[dict[str, Any]], name: str) -> list[str]:
    return sorted({str(each[name]) for each in prints if name in each})
