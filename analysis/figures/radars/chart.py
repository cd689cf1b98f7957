"""All challenges at a glance: each teacher as a ratio of Random."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.data.reference import BASELINE, is_baseline
from analysis.figures.elements.checks import require, require_unique, significant
from analysis.figures.elements.legends import legend, legend_height, mark_handle, teacher_handle
from analysis.figures.radars.radar_axes import LABEL, RadarAxes
from analysis.figures.radars.ratios import Ratios, ratios_of_random
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.names import label, teacher_order
from tma_ray.benchmark import ORIGINAL_SPACE, STUMP_TRACKS_CHALLENGES, Matrix, find_challenge
from tma_ray.tasks import KnowledgeLevel

PANEL_HEIGHT, CENTRE = 2.98, 1.32
"""Height of a panel without notes, and of its centre above them, inches."""


@styled
def radar(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    challenges: Sequence[Matrix] = STUMP_TRACKS_CHALLENGES,
    original: Matrix = ORIGINAL_SPACE,
) -> Figure:
    """Draws results on challenges as ratios of Random's mean, one panel per level of expert knowledge.

    Stars at the end of an axis, in the teachers' colours and order, say who is significantly better than
    Random there; marks on lines are filled where a teacher differs from Random, either way. A plus is the
    best result on the original space at that level, as a ratio of Random on that challenge, where bodies
    and students are those of the original space. A line has a gap where the result or Random is missing.

    Args:
        table: of `pooling.pooled` (after `pooling.reuse_random`, since Random needs no knowledge) or
            `published.paper_frame`; other environments and challenges are left out.
        tests: of `pairwise.pairwise` or `pairwise_statistics.pairwise_from_statistics` against "random".
        measure: what is drawn.
        challenges: axes, clockwise from the top; at least three.
        original: where the upper baseline comes from.

    Raises:
        ValueError: under three challenges, no results of any, or several of a teacher on one of them.
    """
    mean = f"{measure}_mean"
    if len(challenges) < 3:
        raise ValueError(f"radar of {len(challenges)} challenges: expected at least 3")
    require(table, ["environment", "challenge", "expert_knowledge", "teacher", mean], "results")
    environment, names = challenges[0].environment, [matrix.challenge for matrix in challenges]
    table = table[(table["environment"] == environment) & table[mean].notna()]
    results = table[table["challenge"].isin(names)]
    require(results, [], f"results on {', '.join(names)} of {environment}")
    table = table[table["challenge"].isin([*names, original.challenge])]
    require_unique(table, ["challenge", "expert_knowledge", "teacher"], "results")
    levels = [level.value for level in KnowledgeLevel if level.value in set(results["expert_knowledge"])]
    tests = significant(tests[(tests["environment"] == environment) & (tests["second"].map(is_baseline))])
    teachers = sorted(results["teacher"].unique(), key=teacher_order)
    panels = {}
    for level in levels:
        here = table[table["expert_knowledge"] == level]
        places = zip(here["teacher"].astype(str), here["challenge"].astype(str), strict=True)
        means = dict(zip(places, here[mean].astype(float), strict=True))
        mine = tests[tests["expert_knowledge"] == level]
        panels[level] = ratios_of_random(means, mine, teachers, challenges, original)
    return _drawn(panels, teachers, [find_challenge(environment, name).title for name in names])


def _drawn(panels: dict[str, Ratios], teachers: Sequence[str], titles: Sequence[str]) -> Figure:
    lines = [value for panel in panels.values() for line in panel.ratios.values() for value in line]
    uppers = [value for panel in panels.values() for value in panel.upper if math.isfinite(value)]
    high = max([*uppers, *(value for value in lines if math.isfinite(value))], default=1.0)
    notes = {level: textwrap.wrap("; ".join(panel.missing), 42) for level, panel in panels.items()}
    width = TWO_COLUMNS if len(panels) > 1 else ONE_COLUMN
    legends = _handles(teachers, bool(uppers))
    below = 0.11 * max(map(len, notes.values()))
    above = [legend_height(handles, width, LABEL) for handles in legends]
    figure = Figure(figsize=(width, below + PANEL_HEIGHT + sum(above)))
    for column, (level, panel) in enumerate(panels.items()):
        axes = RadarAxes(figure, (width * (column + 0.5) / len(panels), below + CENTRE), titles, high)
        axes.title(f"{'no' if level == KnowledgeLevel.NONE else level} expert knowledge".capitalize())
        for teacher, values in panel.ratios.items():
            filled = [is_baseline(teacher) or (teacher, i) in panel.differ for i in range(len(titles))]
            axes.line(teacher, values, filled)
        axes.upper(panel.upper)
        axes.stars(panel.stars)
        axes.note("\n".join(notes[level]))
    for handles, height in zip(legends, (0, above[0]), strict=True):
        top = 1 - height / figure.get_figheight()
        legend(figure, handles, "upper center", LABEL, bbox_to_anchor=(0.5, top))
    return figure


def _handles(teachers: Sequence[str], with_upper: bool) -> tuple[list[Line2D], list[Line2D]]:
    """Returns what is explained: the teachers, Random always, and the marks."""
    others = [teacher_handle(teacher) for teacher in teachers if not is_baseline(teacher)]
    marks = [
        mark_handle("*", "better than Random (p < 0.05)", markersize=6),
        mark_handle("o", "differs from Random", markersize=4),
        mark_handle("o", "does not", markersize=4, markerfacecolor="white"),
        mark_handle("+", "best on the original space", markersize=6),
    ]
    random = teacher_handle(BASELINE, label=f"{label(BASELINE)} (= 1)")
    return [random, *others], marks if with_upper else marks[:-1]
