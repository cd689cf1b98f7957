"""Maps of test tasks by the share of runs that master them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.data.curricula import Axis, stack
from analysis.names import short_labels

SHARES = base.ColourScale("Blues", 0.0, 100.0, "Seeds that master the task (%)")
"""Colours of shares of runs."""

ACROSS = 180  # total width of a row of squares, in CSS pixels


def mastery_chart(
    shares: pd.DataFrame, tasks: pd.DataFrame, axes: Sequence[Axis], name: str = "mastery", caption: str = ""
) -> base.Chart:
    """Return a chart with a panel per teacher and a mark per test task, darker the more runs master it.

    Tasks with two dimensions lie on the task plane, others in a square, the most mastered ones first.

    Args:
        shares: teacher, step (of an evaluation, or `END`), task_index and share (in [0, 1]).
        tasks: task_index and task (float32 (d,)) of the test set.
        axes: dimensions of the task space.
        name: identifier of the chart.
        caption: content and number of runs.
    """
    tasks = tasks.sort_values("task_index", ignore_index=True)
    values = stack(tasks["task"])
    words = [", ".join(f"{value:.4g}" for value in task) for task in values]
    if len(axes) == 2 == values.shape[1]:
        points = values.astype(np.float64)
        draw, scales = _heatmap(points, words) or _squares(points, words), list[base.PanelAxis]()
        for axis, positions in zip(axes, points.T, strict=True):  # bounds with a margin of half a cell
            centres = np.unique(positions)
            half = float(np.diff(centres).min()) / 2 if len(centres) > 1 else 0.5
            scales.append(
                base.PanelAxis(
                    axis.name, base.AxisKind.TASK, float(centres[0]) - half, float(centres[-1]) + half
                )
            )
    else:
        mean = shares[shares["step"] == base.END].groupby("task_index")["share"].mean()
        mean = mean.reindex(tasks["task_index"]).fillna(-1)
        rank = np.argsort(np.argsort(-mean.to_numpy(), kind="stable"), kind="stable")
        side = int(np.ceil(np.sqrt(2 * len(tasks))))  # columns, about twice as many as rows
        points = np.column_stack([rank % side, -(rank // side)]).astype(np.float64)
        draw, scales = _squares(points, words), [base.PanelAxis(shown=False), base.PanelAxis(shown=False)]
    panels = [
        _panel(shares[shares["teacher"] == teacher], tasks["task_index"], label, scales, draw)
        for teacher, label in short_labels(shares["teacher"].astype(str), base.LONGEST_NAME).items()
    ]
    rows = base.grid(panels, 4)
    width = 2.75 if len(panels) < 4 else 2.25
    size = width * len(rows[0]) + 1.2, (width + 0.1) * len(rows) + 0.55
    return base.Chart(name, rows, "Which test tasks are mastered", caption, size=size, pixels=270)


def _panel(
    shares: pd.DataFrame,
    tasks: pd.Series,
    name: str,
    axes: Sequence[base.PanelAxis],
    draw: Callable[[base.Array], base.Mark],
) -> base.Panel:
    """Return the animated panel of one teacher, with the mean share in its title."""
    teacher = str(shares["teacher"].iloc[0])
    rows, steps = pd.factorize(shares["step"])
    columns = pd.Index(tasks).get_indexer(shares["task_index"])
    table = np.full((len(steps), len(tasks) + 1), np.nan)  # tasks of other test sets go to column -1
    table[rows, columns] = 100 * shares["share"].to_numpy(np.float64)
    percents = dict(zip(steps, table[:, :-1].round(1), strict=True))

    def at(step: Any) -> base.Panel:
        percent = percents[step]
        finite = percent[np.isfinite(percent)]
        title = f"{name}   {finite.mean():.1f}\N{NO-BREAK SPACE}%" if len(finite) else name
        return base.Panel(axes[0], axes[1], [draw(percent)], title, teacher=teacher)

    return base.animated(at, list(percents), base.END)


def mastery_map(shares: pd.DataFrame, tasks: pd.DataFrame, plane: tuple[Axis, Axis] | None) -> base.Chart:
    """Return a map of the share of runs that master each test task at the end of training.

    A panel per teacher if the tasks form a grid on the plane, else a row per teacher and a column per task,
    from the most to the least mastered.

    Args:
        shares: teacher, task_index and share, of one comparison and one test set.
        tasks: task_index and task (float32 (d,)) of the test set.
        plane: two dimensions of the tasks; None for others.
    """
    points = stack(tasks["task"]).astype(np.float64)
    if plane is not None and points.shape[1:] == (2,) and _heatmap(points, ()) is not None:
        return mastery_chart(shares.assign(step=base.END), tasks, plane)
    names = short_labels(shares["teacher"].unique())
    table = shares.pivot_table(index="teacher", columns="task_index", values="share").loc[list(names)]
    order = table.mean().sort_values(ascending=False, kind="stable").index
    marks = base.Heatmap(
        xs=np.arange(table.shape[1], dtype=np.float64),
        ys=np.arange(len(names), dtype=np.float64),
        values=100 * table[order].to_numpy(np.float64),
        colours=SHARES,
    )
    rows = base.PanelAxis(kind=base.AxisKind.TEACHERS, rows=names)
    panel = base.Panel(base.PanelAxis("Test tasks, from the most to the least often mastered"), rows, [marks])
    size = base.PAGE_WIDTH, 1.0 + 0.3 * len(names)
    return base.Chart("mastery", [[panel]], legend=base.Legend.NONE, size=size)


def _heatmap(points: base.Array, words: Sequence[str]) -> Callable[[base.Array], base.Mark] | None:
    """Return a function that draws values (n,) as a heatmap; None if `points` (n, 2) are not a full grid."""
    xs, columns = np.unique(points[:, 0], return_inverse=True)
    ys, rows = np.unique(points[:, 1], return_inverse=True)
    full = len(xs) * len(ys) == len(np.unique(points, axis=0)) == len(points)
    if not full or min(len(xs), len(ys)) < 2:
        return None

    def draw(values: base.Array) -> base.Mark:
        table, order = np.full((len(ys), len(xs)), np.nan), np.empty((len(ys), len(xs)), dtype=int)
        table[rows, columns], order[rows, columns] = values, np.arange(len(points))
        texts = [words[index] for index in order.ravel()] if words else []
        hover = "task {text}<br>{value} % of seeds"
        return base.Heatmap(
            xs=xs.round(4), ys=ys.round(4), values=table, colours=SHARES, texts=texts, hover=hover
        )

    return draw


def _squares(points: base.Array, words: Sequence[str]) -> Callable[[base.Array], base.Mark]:
    """Return a function that draws values (n,) as coloured squares at `points` (n, 2)."""
    size = float(np.clip(ACROSS / np.sqrt(max(len(points), 1)), 4, 24))

    def draw(values: base.Array) -> base.Mark:
        return base.Scatter(
            x=points[:, 0].round(4),
            y=points[:, 1].round(4),
            values=values,
            colours=SHARES,
            size=size,
            look=base.PLAIN._replace(marker="s"),
            edge="#c3c9d1",
            texts=words,
            hover="task {text}<br>{value} % of seeds",
        )

    return draw
