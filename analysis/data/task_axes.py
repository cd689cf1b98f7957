"""The dimensions of a task space as axes of figures."""

from __future__ import annotations

from typing import Any, NamedTuple

import pandas as pd

from analysis.data.arguments import check_columns
from analysis.data.specs import parsed


class Axis(NamedTuple):
    """One dimension of the task space: how it is called, with its unit, and its bounds."""

    name: str
    low: float
    high: float


def task_axes(cells: pd.DataFrame) -> tuple[Axis, ...]:
    """Returns the dimensions that teachers choose from in the runs of `cells`; none where it is unknown."""
    check_columns("cells", cells, ["spec"])
    for spec in cells["spec"].dropna():
        return tuple(_axis(dimension) for dimension in parsed(spec).get("task_space", []))
    return ()


def _axis(dimension: dict[str, Any]) -> Axis:
    name = str(dimension["name"]).replace("_", " ").capitalize()
    unit = f" ({dimension['unit']})" if dimension.get("unit") else ""
    return Axis(name + unit, float(dimension["low"]), float(dimension["high"]))
