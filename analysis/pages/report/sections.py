"""One comparison of teachers as a section of the report: sentences, a table, charts, figures."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from analysis.comparisons.examples import curricula_of
from analysis.comparisons.findings import findings
from analysis.comparisons.measured import Measured
from analysis.data.frames import Frames
from analysis.figures.curricula.pictures import curriculum_pictures
from analysis.figures.picture import Picture
from analysis.names import challenge_title
from analysis.pages.charts import Chart
from analysis.pages.controls import FILTERS
from analysis.pages.report.comparison_charts import Panel, charts_of, panels_of
from analysis.pages.report.rows import end_rows, step_rows


@dataclass(frozen=True, eq=False)
class Section:
    """One comparison.

    Attributes:
        anchor: identifier on the page.
        title: what is compared.
        chosen_by: its values in the columns of `controls.FILTERS`.
        sentences: what was found.
        rows: cells of the table, one row per teacher, at the ends of runs.
        step_rows: JSON of what changes of them at every evaluation.
        charts: for all teachers each.
        panels: charts for one teacher each.
        pictures: figures that stay as they are.
    """

    anchor: str
    title: str
    chosen_by: dict[str, str]
    sentences: list[str]
    rows: list[dict[str, Any]]
    step_rows: str
    charts: list[Chart]
    panels: list[Panel]
    pictures: list[Picture]


def sections(frames: Frames, measured: Measured, shown: Collection[str]) -> Iterator[Section]:
    """Yields a section for each comparison of the root, in a fixed order.

    Args:
        frames: of the root.
        measured: of the root.
        shown: teachers that figures have, which cannot be chosen on the page as charts can.
    """
    for anchor, title, mine in titled(measured):
        curricula = curricula_of(frames, mine)  # read once, for charts and figures
        leading = {teacher: each for teacher, each in curricula.items() if teacher in shown}
        pictures = curriculum_pictures(mine, leading)
        first = mine.cells.iloc[0]
        yield Section(
            anchor=anchor,
            title=title,
            chosen_by={column: str(first[column]) for column in FILTERS},
            sentences=findings(mine.summary, mine.tests),
            rows=end_rows(mine),
            step_rows=json.dumps(step_rows(mine, measured)).replace("<", "\\u003c"),
            charts=list(charts_of(mine, anchor)),
            panels=list(panels_of(frames, mine, curricula, anchor)),
            pictures=[replace(picture, name=f"{anchor}-{picture.name}") for picture in pictures],
        )


def titled(measured: Measured) -> Iterator[tuple[str, str, Measured]]:
    """Yields the anchor, title and part of each comparison of the root, in a fixed order."""
    several = {name: measured.cells[name].nunique() > 1 for name in ("experiment", "engine")}
    for count, mine in enumerate(measured.comparisons, start=1):
        yield f"comparison-{count}", _title(mine.cells.iloc[0], several), mine


def _title(comparison: pd.Series, several: dict[str, bool]) -> str:
    """Returns what a comparison is about."""
    name = comparison["challenge"]
    challenge = challenge_title(comparison["environment"], name, name)
    parts = [
        comparison["environment"].replace("_", " ").capitalize(),
        challenge[:1].lower() + challenge[1:],
        comparison["embodiment"].replace("_", " "),
        comparison["student"].upper(),
        f"expert knowledge {comparison['expert_knowledge']}",
    ]
    if several["engine"]:
        parts.append(comparison["engine"])
    if several["experiment"] and comparison["experiment"] != comparison["challenge"]:
        parts.insert(0, comparison["experiment"])
    return ", ".join(part for part in parts if part)
