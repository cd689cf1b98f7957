"""Learning curves with stars where they differ: teachers from Random, or levels of expert knowledge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import ScaledTranslation

from analysis.data.reference import is_baseline
from analysis.figures.elements.axes import percent_axis, share_step_label, step_axis
from analysis.figures.elements.checks import require, require_unique, significant
from analysis.figures.elements.legends import legend, legend_height, mark_handle
from analysis.figures.elements.level_look import Line, LineLooks
from analysis.figures.elements.lines import draw_line
from analysis.figures.elements.task_planes import remark
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.looks import INK
from analysis.names import label, teacher_order, title

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
