"""All challenges at a glance: each teacher as a ratio of Random."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures.checks import require, require_unique, significant
from analysis.figures.legends import legend, legend_height, mark_handle, teacher_handle
from analysis.figures.ratios import Ratios, ratios_of_random
from analysis.figures.spokes import LABEL, Spokes
from analysis.measures import BASELINE, is_baseline
from analysis.style import ONE_COLUMN, TWO_COLUMNS, label, styled, teacher_order
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

    Stars at the end of a spoke, in the teachers' colours and order, say who is significantly better than
    Random there; marks on lines are filled where a teacher differs from Random, either way. A plus is the
    best result on the original space at that level, as a ratio of Random on that challenge, where bodies
    and students are those of the original space. A line has a gap where there is no result or no Random.

    Args:
        table: of `pooling.pooled` (after `pooling.lend_baseline`, since Random needs no knowledge) or
            `published.paper_frame`; other environments and challenges are left out.
        tests: of `pairwise.pairwise` or `pairwise_statistics.pairwise_from_statistics` against "random".
        measure: what is drawn.
        challenges: spokes, clockwise from the top; at least three.
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
    spokes = table[table["challenge"].isin(names)]
    require(spokes, [], f"results on {', '.join(names)} of {environment}")
    table = table[table["challenge"].isin([*names, original.challenge])]
    require_unique(table, ["challenge", "expert_knowledge", "teacher"], "results")
    levels = [level.value for level in KnowledgeLevel if level.value in set(spokes["expert_knowledge"])]
    tests = significant(tests[(tests["environment"] == environment) & (tests["second"].map(is_baseline))])
    teachers = sorted(spokes["teacher"].unique(), key=teacher_order)
    readings = {}
    for level in levels:
        here = table[table["expert_knowledge"] == level]
        places = zip(here["teacher"].astype(str), here["challenge"].astype(str), strict=True)
        means = dict(zip(places, here[mean].astype(float), strict=True))
        mine = tests[tests["expert_knowledge"] == level]
        readings[level] = ratios_of_random(means, mine, teachers, challenges, original)
    return _drawn(readings, teachers, [find_challenge(environment, name).title for name in names])


def _drawn(readings: dict[str, Ratios], teachers: Sequence[str], titles: Sequence[str]) -> Figure:
    lines = [value for reading in readings.values() for line in reading.ratios.values() for value in line]
    uppers = [value for reading in readings.values() for value in reading.upper if math.isfinite(value)]
    high = max([*uppers, *(value for value in lines if math.isfinite(value))], default=1.0)
    notes = {level: textwrap.wrap("; ".join(reading.missing), 42) for level, reading in readings.items()}
    width = TWO_COLUMNS if len(readings) > 1 else ONE_COLUMN
    legends = _handles(teachers, bool(uppers))
    below = 0.11 * max(map(len, notes.values()))
    above = [legend_height(handles, width, LABEL) for handles in legends]
    figure = Figure(figsize=(width, below + PANEL_HEIGHT + sum(above)))
    for column, (level, reading) in enumerate(readings.items()):
        spokes = Spokes(figure, (width * (column + 0.5) / len(readings), below + CENTRE), titles, high)
        spokes.title(f"{'no' if level == KnowledgeLevel.NONE else level} expert knowledge".capitalize())
        for teacher, values in reading.ratios.items():
            filled = [is_baseline(teacher) or (teacher, i) in reading.differ for i in range(len(titles))]
            spokes.line(teacher, values, filled)
        spokes.upper(reading.upper)
        spokes.stars(reading.stars)
        spokes.note("\n".join(notes[level]))
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
