"""All challenges at a glance: each teacher as a ratio of Random."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.data.reference import BASELINE, is_baseline
from analysis.figures.elements.checks import require, require_unique, significant
from analysis.figures.elements.legends import legend, legend_height, mark_handle, teacher_handles
from analysis.figures.radars.radar_axes import LABEL, RadarAxes
from analysis.figures.radars.ratios import Ratios, ratios_of_random
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.looks import shown_together
from analysis.names import teacher_order
from tma_ray.benchmark import ORIGINAL_SPACE, STUMP_TRACKS_CHALLENGES, Matrix, find_challenge
from tma_ray.tasks import KnowledgeLevel

PANEL_HEIGHT, CENTRE = 3.08, 1.36
"""Height of a panel without notes, and of its centre above them, inches."""

TOGETHER = 8
"""Teachers beside Random in one panel; more of them are drawn in further rows of panels."""


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
    Where Random is at 0, results over 0 lie in a band outside of the rings, the best at its outer edge.

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
    panels, doubts = {}, {}
    for level in levels:
        here = table[table["expert_knowledge"] == level]
        places = zip(here["teacher"].astype(str), here["challenge"].astype(str), strict=True)
        means = dict(zip(places, here[mean].astype(float), strict=True))
        mine = tests[tests["expert_knowledge"] == level]
        doubts[level] = _doubts(here, names)
        panels[level] = ratios_of_random(means, mine, teachers, challenges, original)
    with shown_together(teachers):
        return _drawn(panels, doubts, teachers, [find_challenge(environment, name).title for name in names])


def _doubts(here: pd.DataFrame, names: Sequence[str]) -> set[tuple[str, int]]:
    """Returns teachers and axes of results that may be slips of who published them."""
    rows = (
        here[here["challenge"].isin(names) & here["doubt"].fillna("").ne("")] if "doubt" in here else here[:0]
    )
    return {(str(row["teacher"]), names.index(row["challenge"])) for _, row in rows.iterrows()}


def _drawn(
    panels: dict[str, Ratios],
    doubts: dict[str, set[tuple[str, int]]],
    teachers: Sequence[str],
    titles: Sequence[str],
) -> Figure:
    """Draws a row of panels, one for each level, for every `TOGETHER` teachers."""
    values = [value for panel in panels.values() for value in (*_values(panel), *panel.upper)]
    high = max(filter(math.isfinite, values), default=1.0)
    beyond = any(map(math.isinf, values))
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    groups = [others[start : start + TOGETHER] for start in range(0, len(others), TOGETHER)] or [[]]
    said = {
        level: [*panel.missing, *(["\N{DAGGER} doubtful result"] if doubts[level] else [])]
        for level, panel in panels.items()
    }
    notes = {level: textwrap.wrap("; ".join(texts), 42) for level, texts in said.items()}
    width = TWO_COLUMNS if len(panels) > 1 else ONE_COLUMN
    below = 0.11 * max(map(len, notes.values()))
    named = [teacher_handles([BASELINE, *group]) for group in groups]
    marks = _marks(
        any(math.isfinite(value) or math.isinf(value) for p in panels.values() for value in p.upper)
    )
    heights = [PANEL_HEIGHT + legend_height(handles, width, LABEL) for handles in named]
    marks_height = legend_height(marks, width, LABEL)
    figure = Figure(figsize=(width, below + marks_height + sum(heights)))
    total = figure.get_figheight()
    legend(figure, marks, "upper center", LABEL, bbox_to_anchor=(0.5, 1.0))
    top = total - marks_height
    for group, handles, height in zip(groups, named, heights, strict=True):
        legend(figure, handles, "upper center", LABEL, bbox_to_anchor=(0.5, top / total))
        top -= height
        for column, (level, panel) in enumerate(panels.items()):
            centre = (width * (column + 0.5) / len(panels), top + CENTRE)
            axes = RadarAxes(figure, centre, titles, high, beyond)
            axes.title(f"{'no' if level == KnowledgeLevel.NONE else level} expert knowledge".capitalize())
            _draw_panel(axes, panel, group)
            axes.doubts(_places_of(doubts[level], panel, axes, group))
            if group is groups[-1]:
                axes.note("\n".join(notes[level]))
    return figure


def _places_of(
    doubts: set[tuple[str, int]], panel: Ratios, axes: RadarAxes, group: Sequence[str]
) -> Iterator[tuple[int, float]]:
    """Yields axis and radius of the doubtful results of some teachers, and of Random."""
    for teacher, axis in sorted(doubts):
        if teacher in group or is_baseline(teacher):
            value = panel.ratios[teacher][axis]
            yield axis, axes.radius(value, panel.shares.get((teacher, axis), 1.0))


def _values(panel: Ratios) -> Iterator[float]:
    return (value for line in panel.ratios.values() for value in line)


def _draw_panel(axes: RadarAxes, panel: Ratios, group: Sequence[str]) -> None:
    for teacher, values in panel.ratios.items():
        if teacher not in group and not is_baseline(teacher):
            continue
        radii = [axes.radius(value, panel.shares.get((teacher, i), 1.0)) for i, value in enumerate(values)]
        filled = [is_baseline(teacher) or (teacher, i) in panel.differ for i in range(len(values))]
        axes.line(teacher, radii, filled)
    axes.upper([axes.radius(value) for value in panel.upper])
    axes.stars([star for star in panel.stars if star.teacher in group])


def _marks(with_upper: bool) -> list[Line2D]:
    """Returns what the marks mean, for a legend."""
    marks = [
        mark_handle("*", "better than Random (p < 0.05)", markersize=6),
        mark_handle("o", "differs from Random (= 1)", markersize=4),
        mark_handle("o", "does not", markersize=4, markerfacecolor="white"),
        mark_handle("+", "best on the original space", markersize=6),
    ]
    return marks if with_upper else marks[:-1]
