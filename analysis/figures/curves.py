"""Learning curves with what tests say: panels with stars, every pair of teachers, the matrix of many."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.transforms import ScaledTranslation

from analysis.comparisons.frame import pairwise
from analysis.data.reference import BASELINE, is_baseline
from analysis.figures.elements import (
    LEAST_PERCENT,
    Line,
    LineLooks,
    draw_line,
    legend,
    legend_height,
    mark_handle,
    percent_axis,
    remark,
    require,
    require_unique,
    share_step_label,
    significant,
    step_axis,
    teacher_handles,
)
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.formatting import amount
from analysis.looks import INK, MUTED, look
from analysis.measures.pooling import COMPARED, PLUS, pooled
from analysis.names import label, order, short_labels, teacher_order, title
from tma_ray.tasks import KnowledgeLevel

EVERY = 5_000_000
"""Steps between two stars (paper, figures of Parkour)."""

TOGETHER = 8
"""Teachers beside Random in one panel; more of them are drawn in several, each with its own legend."""

STAR_ROW = 6.5
"""Height of a row of stars, points."""


@dataclass(frozen=True, eq=False)
class CurvePanel:
    """One panel of `curves_with_stars`.

    Attributes:
        title: what it shows, such as the body or the challenge.
        curves: of ``pooled(runs, [measure], by=["step"])``: teacher, expert_knowledge, step, n, and
            `measure` with the endings _mean and _std.
        tests: of `pairwise.pairwise` with step among `within`, against one reference: of teachers, or
            between levels with teacher among `within`; None for no stars.
        measure: what is drawn.
        name: what that is, with its unit.
    """

    title: str
    curves: pd.DataFrame
    tests: pd.DataFrame | None = None
    measure: str = "mastered_percent"
    name: str = "Mastered test tasks (%)"


@styled
def curves_with_stars(panels: Sequence[CurvePanel], every: int = EVERY, columns: int = 2) -> Figure:
    """Draws mean ± standard error against steps, and above each panel stars where lines differ.

    Colour and marker say the teacher, dashes and the filling of markers the level of expert knowledge where
    a figure has several. Stars have a row for each line, with its marker at the end of the row: full where
    the line is significantly above the reference, hollow where it is below.

    Args:
        panels: row by row.
        every: steps between two stars.
        columns: panels side by side, if there are as many.

    Raises:
        ValueError: no panels, none with results, two values of a line at a step, or tests none of which is
            at a multiple of `every`.
    """
    if not panels:
        raise ValueError("no panels: expected at least one")
    given = len(panels)
    panels = [part for panel in panels for part in _parts(panel)]
    tables = [_table(panel) for panel in panels]
    if all(table.empty for table in tables):
        raise ValueError("no panel has results: expected at least one with something to draw")
    stars = [_stars(panel, every) for panel in panels]
    looks = LineLooks(line for table in tables for line in _lines(table))
    starred = [line for line in looks.lines if any(line in set(found["line"]) for found in stars)]
    split = len(panels) > given
    handles = [*(() if split else map(looks.handle, looks.lines)), *_star_handles(panels, stars)]
    columns = 1 if split else min(columns, len(panels))
    figure, grid = _grid(len(panels), columns, 0 if split else len(starred), handles)
    last = max(table["step"].max() for table in tables if len(table))
    for axes, panel, table, found in zip(grid, panels, tables, stars, strict=True):
        _draw_panel(axes, panel, table, looks)
        mine = [line for line in starred if not split or line in set(found["line"])]
        _draw_stars(axes, found, mine, looks)
        if split:
            _own_legend(axes, table, looks)
        axes.set_title(panel.title, fontsize=8, pad=4 + STAR_ROW * len(mine))
        step_axis(axes, last, ticks=5)
    share_step_label(figure, np.array(grid))
    legend(figure, handles, "outside upper center")
    return figure


def _parts(panel: CurvePanel) -> list[CurvePanel]:
    """Returns a panel of many teachers as several, each with the baseline and `TOGETHER` others."""
    teachers = sorted(panel.curves["teacher"].unique(), key=teacher_order) if len(panel.curves) else []
    others = [teacher for teacher in teachers if not is_baseline(teacher)]
    if len(others) <= TOGETHER:
        return [panel]
    base = [teacher for teacher in teachers if is_baseline(teacher)]
    groups = [others[start : start + TOGETHER] for start in range(0, len(others), TOGETHER)]
    return [
        replace(
            panel,
            title=f"{panel.title} ({number} of {len(groups)})",
            curves=panel.curves[panel.curves["teacher"].isin([*base, *group])],
            tests=_tests_of(panel.tests, group),
        )
        for number, group in enumerate(groups, start=1)
    ]


def _tests_of(tests: pd.DataFrame | None, teachers: Sequence[str]) -> pd.DataFrame | None:
    """Returns the tests of some teachers against the baseline, or between their levels."""
    if tests is None:
        return None
    return tests[tests["teacher" if "teacher" in tests else "first"].isin(teachers)]


def _own_legend(axes: Axes, table: pd.DataFrame, looks: LineLooks) -> None:
    """Explains the lines of one of several panels of many teachers, beside it."""
    handles = [looks.handle(line) for line in looks.lines if line in _lines(table)]
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.03, 0.5), fontsize=6, handlelength=2.6)


def _grid(count: int, columns: int, starred: int, handles: Sequence[Line2D]) -> tuple[Figure, list[Axes]]:
    lines = -(-count // columns)
    width = TWO_COLUMNS if columns > 1 else ONE_COLUMN
    height = 0.45 + legend_height(handles, width) + lines * (1.9 + STAR_ROW * starred / 72)
    figure = Figure(figsize=(width, height), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False).ravel().tolist()
    for spare in grid[count:]:
        spare.remove()
    return figure, grid[:count]


def _table(panel: CurvePanel) -> pd.DataFrame:
    """Returns teacher, expert_knowledge, step, n, mean and standard_error, sorted by step."""
    mean, std = f"{panel.measure}_mean", f"{panel.measure}_std"
    names = ["teacher", "expert_knowledge", "step", "n", mean, std]
    if len(panel.curves):
        require(panel.curves, names, f"curves of panel {panel.title!r}")
    table = panel.curves.reindex(columns=names).rename(columns={mean: "mean", std: "std"})
    require_unique(table, ["teacher", "expert_knowledge", "step"], f"curves of panel {panel.title!r}")
    table = table[table["mean"].notna()].sort_values("step")
    return table.assign(standard_error=table["std"] / np.sqrt(table["n"].astype(float)))


def _lines(table: pd.DataFrame) -> set[Line]:
    return set(table[["teacher", "expert_knowledge"]].itertuples(index=False, name=None))


def _stars(panel: CurvePanel, every: int) -> pd.DataFrame:
    """Returns line, step and difference of the significant tests at multiples of `every`."""
    empty = pd.DataFrame(columns=["line", "step", "difference"])
    if panel.tests is None or panel.tests.empty:
        return empty
    require(panel.tests, ["step", "first", "second", "holm", "difference"], f"tests of panel {panel.title!r}")
    due = panel.tests[(panel.tests["step"] > 0) & (panel.tests["step"] % every == 0)]
    if due.empty:
        raise ValueError(
            f"tests of panel {panel.title!r}: none at a multiple of {every:,} steps; tested at "
            f"{', '.join(f'{step:,.0f}' for step in sorted(panel.tests['step'].unique())[:5])}…"
        )
    between_levels = "teacher" in panel.tests
    rows = significant(due)
    teachers, levels = ("teacher", "first") if between_levels else ("first", "expert_knowledge")
    lines = pd.Series(list(zip(rows[teachers], rows[levels], strict=True)), index=rows.index, dtype=object)
    return rows[["step", "difference"]].assign(line=lines)


def _draw_panel(axes: Axes, panel: CurvePanel, table: pd.DataFrame, looks: LineLooks) -> None:
    axes.grid(axis="y")
    axes.tick_params(labelsize=7)
    axes.set_ylabel(panel.name, fontsize=7.5)
    if table.empty:
        remark(axes, "no results")
        return
    for line in looks.lines:
        mine = table[(table["teacher"] == line[0]) & (table["expert_knowledge"] == line[1])]
        draw_line(axes, mine, looks.look(line), looks.name(line), looks.fill(line), width=1.3)
    percent_axis(axes, panel.measure)


def _draw_stars(axes: Axes, stars: pd.DataFrame, rows: Sequence[Line], looks: LineLooks) -> None:
    for place, line in enumerate(reversed(rows)):
        rise = ScaledTranslation(0, (5 + STAR_ROW * place) / 72, axes.figure.dpi_scale_trans)
        mine = stars[stars["line"] == line]
        style = looks.look(line)
        marks: dict[str, Any] = {"linestyle": "none", "color": style.colour, "clip_on": False}
        for above in (True, False):
            steps = mine.loc[(mine["difference"] > 0) == above, "step"].to_numpy(float)
            if not len(steps):  # an empty line would count as one at the corner of the figure
                continue
            axes.plot(
                steps,
                np.ones(len(steps)),
                marker="*",
                markersize=5.5,
                markerfacecolor=style.colour if above else "white",
                markeredgewidth=0.6,
                transform=axes.get_xaxis_transform() + rise,
                gid=f"{'above' if above else 'below'}-{'-'.join(line)}",
                **marks,
            )
        end = axes.transAxes + rise + ScaledTranslation(9 / 72, 0, axes.figure.dpi_scale_trans)
        marks |= {
            "marker": style.marker,
            "markersize": 3.5,
            "markerfacecolor": looks.fill(line),
            "markeredgewidth": 0.6,
        }
        axes.plot([1], [1], transform=end, **marks)


def _star_handles(panels: Sequence[CurvePanel], stars: Sequence[pd.DataFrame]) -> list[Line2D]:
    """Returns what full and hollow stars mean, of those that there are."""
    tests = [panel.tests for panel in panels if panel.tests is not None and len(panel.tests)]
    references = sorted({str(name) for table in tests for name in table["second"]})
    levels = any("teacher" in table for table in tests)
    names = [title("expert_knowledge", name).lower() if levels else label(name) for name in references]
    differences = np.concatenate([found["difference"].to_numpy(float) for found in stars])
    kinds = (("above", differences > 0, INK), ("below", differences < 0, "white"))
    return [
        mark_handle(
            "*",
            f"{word} {' or '.join(names)} (p < 0.05 after Holm)",
            markersize=6,
            markerfacecolor=inside,
            markeredgewidth=0.6,
        )
        for word, these, inside in kinds
        if these.any()
    ]


MEASURES = {"mastered_percent": "Mastered test tasks (%)", "training_return": "Mean training return"}
"""What case studies show side by side, as their axes call it."""


def body_panels(
    runs: pd.DataFrame, measure: str = "mastered_percent", name: str = "Mastered test tasks (%)"
) -> list[CurvePanel]:
    """Returns a panel over all bodies of a pool, if it has several, and one for each, tested against Random.

    Args:
        runs: rows of `pooling.pool_runs` with the values of `run_measures.evaluations_at`, of one comparison,
            such as Parkour.
        measure: what is drawn.
        name: what that is, with its unit.

    Raises:
        ValueError: the runs are not of one comparison.
    """
    _one(runs, COMPARED)
    panels = []
    if runs["embodiment"].nunique() > 1 or any(PLUS in pool for pool in runs["pool"]):
        tests = pairwise(runs, measure, BASELINE, [*COMPARED, "step"], detectable=False)
        panels.append(CurvePanel("All bodies", pooled(runs, [measure], ["step"]), tests, measure, name))
    for body in sorted(runs["embodiment"].unique()):
        mine = runs[runs["embodiment"] == body]
        curves = pooled(mine, [measure], ["embodiment", "step"])
        tests = pairwise(mine, measure, BASELINE, [*COMPARED, "embodiment", "step"], detectable=False)
        panels.append(CurvePanel(title("embodiment", body), curves, tests, measure, name))
    return panels


def knowledge_panels(
    runs: pd.DataFrame,
    measures: Mapping[str, str] = MEASURES,
    reference: KnowledgeLevel | None = KnowledgeLevel.HIGH,
) -> list[CurvePanel]:
    """Returns a row of panels for each challenge, one for each measure, at all levels of expert knowledge.

    Args:
        runs: rows of `pooling.pool_runs` with the `measures` at each step, of the teachers to be shown.
        measures: columns of `runs`, with what their axes call them.
        reference: the level that the others are tested against; None for no tests.

    Raises:
        ValueError: the runs of a challenge differ in more than level and teacher.
    """
    within = [column for column in COMPARED if column != "expert_knowledge"]
    panels = []
    for challenge in sorted(runs["challenge"].unique(), key=lambda value: order("challenge", value)):
        mine = runs[runs["challenge"] == challenge]
        _one(mine, within)
        for measure, name in measures.items():
            tests, same = None, [*within, "teacher", "step"]
            if reference is not None:
                tests = pairwise(mine, measure, reference.value, same, "expert_knowledge", detectable=False)
            curves = pooled(mine, [measure], ["step"])
            panels.append(CurvePanel(title("challenge", challenge), curves, tests, measure, name))
    return panels


def _one(runs: pd.DataFrame, columns: Sequence[str]) -> None:
    mixed = [column for column in columns if runs[column].nunique(dropna=False) > 1]
    if mixed:
        raise ValueError(
            f"runs of several comparisons: expected one {', '.join(mixed)}; select the rows of one"
        )


COLOURS = "RdBu"
"""From red for below to blue for above; readable with any colour vision."""


def difference_matrix(table: pd.DataFrame, tests: pd.DataFrame, teachers: Sequence[str], name: str) -> Figure:
    """Draws the difference of each row's teacher to each column's, with a dot where it is significant.

    Args:
        table: teacher, step and mean.
        tests: significant ones at every step: first, second and step.
        teachers: rows and columns.
        name: what is measured, with its unit.
    """
    last = table["step"].max()
    means = table[table["step"] == last].set_index("teacher")["mean"].reindex(teachers).to_numpy(float)
    differences = means[:, None] - means[None, :]
    reach = max(float(np.nanmax(np.abs(differences))), 1.0)
    side = min(TWO_COLUMNS + 0.6, 1.9 + 0.17 * len(teachers))
    figure = Figure(figsize=(side + 0.6, side), layout="constrained")
    axes = figure.subplots()
    mesh = axes.imshow(differences, cmap=COLOURS, vmin=-reach, vmax=reach)
    places = {teacher: place for place, teacher in enumerate(teachers)}
    found = tests[tests["step"] == last]
    for first, second in zip(found["first"], found["second"], strict=True):
        ends = places[first], places[second]
        axes.plot(ends, ends[::-1], linestyle="none", marker="o", markersize=2, color="black")
    names = [short_labels(teachers, 18)[teacher] for teacher in teachers]
    axes.set_xticks(range(len(teachers)), names, rotation=90, fontsize=5.5)
    axes.set_yticks(range(len(teachers)), names, fontsize=5.5)
    axes.set_title(f"Row minus column after {amount(last)} steps; dots: p < 0.05 after Holm", fontsize=7)
    bar = figure.colorbar(mesh, ax=axes, fraction=0.04, pad=0.02)
    bar.set_label(f"Difference: {name[:1].lower()}{name[1:]}", fontsize=7)
    bar.outline.set_visible(False)
    return figure


LARGEST = 9
"""With more rows of panels than these, a matrix of the last differences takes the place of curves."""

ROOMY = 3
"""With so many columns of panels the corner above them has room for the legend."""


@styled
def pairwise_curves(
    curves: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = "Mastered test tasks (%)",
) -> Figure:
    """Draws a panel for every pair of teachers, with mean ± standard error of both against steps.

    Stars along the top of a panel mark the steps at which the two differ significantly, in the colour of
    the one that is above. All panels have the same axes. Of more than `LARGEST` + 1
    teachers, `difference_matrix` shows their last step.

    Args:
        curves: of ``pooled(runs, [measure], by=["step"])`` for one comparison: teacher, step, n, and
            `measure` with the endings _mean and _std.
        tests: all pairs at every step, of `pairwise.pairwise` with step among `within`.
        measure: what is drawn.
        name: what that is, with its unit.

    Raises:
        ValueError: under two teachers, or several values of a teacher at a step.
    """
    table = _pair_table(curves, measure)
    teachers = sorted(table["teacher"].unique(), key=teacher_order)
    if len(teachers) < 2:
        raise ValueError(f"curves of {len(teachers)} teachers: expected at least two, to compare them")
    size, tests = len(teachers) - 1, significant(tests)
    if size > LARGEST:
        return difference_matrix(table, tests, teachers, name)
    figure, grid = _pair_grid(size)
    drawn, names = [], short_labels(teachers, 15)
    for row, column in itertools.product(range(size), repeat=2):
        axes = grid[row, column]
        if column > row:
            axes.remove()
            continue
        drawn.append(axes)
        pair = teachers[column], teachers[row + 1]
        _draw_pair(axes, table, pair, measure)
        _draw_pair_stars(axes, tests, pair)
        if column == 0:
            axes.set_ylabel(names[pair[1]], fontsize=6.5, fontweight="bold")
        if row == column:
            axes.set_title(names[pair[0]], fontsize=6.5)
    share_step_label(figure, np.array(drawn))
    figure.supylabel(name, fontsize=8.5)
    _add_legend(figure, teachers, size)
    return figure


def _add_legend(figure: Figure, teachers: list[str], size: int) -> None:
    handles = teacher_handles(teachers, marker="")
    handles.append(mark_handle("*", "differ at this step (p < 0.05)", color=MUTED))
    if size < ROOMY:
        legend(figure, handles, "outside upper center")
    else:
        figure.legend(handles=handles, loc="upper right", fontsize=7, labelspacing=0.35)


def _pair_table(curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns teacher, step, n, mean and standard_error, sorted by step."""
    mean, std = f"{measure}_mean", f"{measure}_std"
    require(curves, ["teacher", "step", "n", mean, std], "curves")
    require_unique(curves, ["teacher", "step"], "curves")
    table = curves[["teacher", "step", "n"]].assign(mean=curves[mean].astype(float))
    table["standard_error"] = curves[std] / np.sqrt(curves["n"].astype(float))
    return table[table["mean"].notna()].sort_values("step")


def _draw_pair(axes: Axes, table: pd.DataFrame, pair: tuple[str, str], measure: str) -> None:
    """Draws two curves on axes that suit the whole table, with room for stars above."""
    for teacher in pair:
        rows = table[table["teacher"] == teacher]
        draw_line(axes, rows, look(teacher), label(teacher), width=0.9)
    error = table["standard_error"].fillna(0.0)
    low, high = min(0.0, (table["mean"] - error).min()), (table["mean"] + error).max()
    axes.set_ylim(low, max(high, low + LEAST_PERCENT))
    percent_axis(axes, measure)
    low, high = axes.get_ylim()
    axes.set_ylim(top=high + 0.16 * (high - low))
    step_axis(axes, table["step"].max(), ticks=2)


def _pair_grid(size: int) -> tuple[Figure, np.ndarray]:
    width = ONE_COLUMN if size == 1 else TWO_COLUMNS
    height = 0.9 + (1.9 if size == 1 else min(1.5, (width - 0.6) / size * 0.9) * size)
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(hspace=0, wspace=0))
    grid = figure.subplots(size, size, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel():
        axes.tick_params(labelsize=6, length=2)
    return figure, grid


def _draw_pair_stars(axes: Axes, tests: pd.DataFrame, pair: tuple[str, str]) -> None:
    """Draws a star at each step at which two teachers differ, in the colour of the one above."""
    for above, below in (pair, pair[::-1]):
        there = (tests["first"] == above) & (tests["second"] == below) & (tests["difference"] > 0)
        here = (tests["first"] == below) & (tests["second"] == above) & (tests["difference"] < 0)
        steps = tests.loc[there | here, "step"].to_numpy(float)
        if not len(steps):
            continue
        axes.plot(
            steps,
            np.full(len(steps), 0.94),
            transform=axes.get_xaxis_transform(),
            linestyle="none",
            marker="*",
            markersize=3.2,
            markeredgewidth=0,
            clip_on=False,
            color=look(above).colour,
            gid=f"{above}-above-{below}",
        )
