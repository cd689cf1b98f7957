"""Sections of a report: sentences, a table, charts and figures of each comparison."""

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import pandas as pd
from numpy.typing import NDArray

from analysis.charts.base import END, MASTERED, Chart
from analysis.charts.curricula import dimension_bands
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import overview_chart, seeds_chart
from analysis.charts.mastery import mastery_chart
from analysis.charts.page import PageChart, on_page
from analysis.charts.paper import Picture, draw
from analysis.charts.profiles import hidden_scalars, scalar_chart
from analysis.charts.tasks import PAGE_EPISODES, probed_tasks, training_tasks
from analysis.comparisons.against_random import Gap
from analysis.comparisons.frame import along_baseline, reference_of
from analysis.comparisons.measured import Measured, curricula_of, in_whose_space, titled, which_runs
from analysis.comparisons.sentences import findings
from analysis.comparisons.verdicts import AXES, on_both_axes, verdict
from analysis.data.columns import FILTERS
from analysis.data.curricula import Curriculum, moments, task_axes
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import amount, caveat, listed, number, p_value, plus_minus
from analysis.measures import evaluations
from analysis.measures.tested import FINAL, HEADLINE, PAPERS, QUANTITIES
from analysis.measures.trained import NEARLY_ALL, trained_shares, with_trained_steps
from analysis.names import label, teacher_order
from analysis.statistics import describe


@dataclass(frozen=True, eq=False)
class Section:
    """One comparison on a page.

    Attributes:
        anchor: identifier on the page.
        title: title of the comparison.
        chosen_by: its values in the columns of `columns.FILTERS`.
        rows: cells of the table, one row per teacher, at the ends of runs.
        step_rows: their changes at every evaluation, by step, teacher and column.
        points: teacher, seed, step (or `END`) and value of every run.
        charts: for all teachers each.
        sentences: findings.
        panels: charts for one teacher each.
        pictures: figures that stay as they are.
    """

    anchor: str
    title: str
    chosen_by: Mapping[str, str]
    rows: Sequence[Mapping[str, Any]]
    step_rows: Mapping[str, Mapping[str, Mapping[str, str]]]
    points: pd.DataFrame
    charts: Sequence[PageChart]
    sentences: Sequence[str] = ()
    panels: Sequence[PageChart] = ()
    pictures: Sequence[Picture] = ()


def overview(
    found: Sequence[Section], titles: Iterable[str], quantity: str, heading: str, caption: str
) -> list[PageChart]:
    """Return the chart of several comparisons at once, if any run was evaluated."""
    points = [section.points.assign(comparison=section.anchor) for section in found]
    if len(found) < 2 or all(table.empty for table in points):
        return []
    table = pd.concat(points, ignore_index=True)
    fewest = table.groupby(["comparison", "teacher"])["seed"].nunique().min()
    rows = dict(zip((section.anchor for section in found), titles, strict=True))
    caption = " ".join(filter(None, [caption, caveat(fewest)]))
    return [on_page(overview_chart(table, rows, quantity, heading, caption))]


def curve_caption(value: str, table: pd.DataFrame) -> str:
    """Return the caption of learning curves of `value`, a column of `table`."""
    text = f"Lines are means over seeds, bands ± one standard error of the mean; {counts(table)}."
    if (table["status"] == "running").any():
        text += " Where some runs have yet to arrive, n is smaller."
    if value == "training_return":
        if table["smoothed"].any():
            text += f" A run counts with the mean of its latest {evaluations.RECENT} episodes."
        text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
    return text


def counts(rows: pd.DataFrame) -> str:
    """Return the number of runs of each teacher: ``n = 4 seeds``, or one number per teacher."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    usual = int(counts.mode().iloc[-1])
    text = f"n = {usual} seed{'s' if usual > 1 else ''}" + (" per teacher" if len(counts) > 1 else "")
    others = [name for name in sorted(counts.index, key=teacher_order) if counts[name] != usual]
    return ", but ".join(
        [text, *([listed(f"{counts[name]} of {label(name)}" for name in others)] if others else [])]
    )


def thresholds(cells: pd.DataFrame) -> str:
    """Return the mastery threshold or thresholds, as text: ``230``."""
    found = sorted(cells["mastery_threshold"].dropna().unique())
    return " or ".join(map(threshold, found))


def threshold(value: float) -> str:
    """Return a mastery threshold as text, without needless decimals."""
    return number(value, 0 if value == round(value) else 2)


CURVES = (
    (PAPERS, MASTERED, "Mastered test tasks at each evaluation"),
    ("evaluation_return", "Mean return on the test set", "Return on the test set"),
    ("training_return", "Mean return of training episodes", "Return in training"),
)
"""Column, label of the axis and title of each learning curve."""

LARGEST = 20
"""Spaces with more varied dimensions are not drawn dimension by dimension."""


def charts_of(mine: Measured, anchor: str, ceiling: float | None) -> Iterator[Chart]:
    """Yield learning curves, and every seed at any step; the ceiling is that of mastered tasks, in %."""
    for value, quantity, title in CURVES:
        table = mine.training if value == "training_return" else mine.evaluations
        if len(table):
            curves, name = (
                evaluations.aggregate(table, value, ["teacher"]),
                f"{anchor}-{value.replace('_', '-')}",
            )
            highest = ceiling if value == PAPERS else None
            yield learning_curves(curves, quantity, name, title, curve_caption(value, table), highest)
    if len(mine.finals):
        caption = f"Rings are seeds, marks their means with 95 % intervals; {counts(mine.finals)}."
        points = points_of(mine.evaluations, mine.finals, HEADLINE)
        yield seeds_chart(points, QUANTITIES[HEADLINE], f"{anchor}-seeds", "Seed by seed", caption)


def trained_chart(frames: Frames, mine: Measured, anchor: str) -> Iterator[Chart]:
    """Yield learning curves against trained steps, if some steps of a teacher do not train."""
    teachers = mine.evaluations.drop_duplicates("run_id").set_index("run_id")["teacher"]
    shares = trained_shares(frames).groupby(teachers.to_dict()).mean()
    fewer = shares[shares < NEARLY_ALL]
    if fewer.empty:
        return
    rows = with_trained_steps(frames, mine.evaluations)
    at = rows.groupby(["teacher", "step"], observed=True)["trained"].mean()
    curves = evaluations.aggregate(rows, PAPERS, ["teacher"])
    curves = curves.assign(step=at.reindex(pd.MultiIndex.from_frame(curves[["teacher", "step"]])).to_numpy())
    told = listed(f"{share:.0f} % of the steps of {label(str(teacher))}" for teacher, share in fewer.items())
    caption = (
        f"Without the steps of episodes that only score or try tasks: {told} trained. "
        f"{curve_caption(PAPERS, mine.evaluations)}"
    )
    title, name = "Mastered test tasks against the steps that trained", f"{anchor}-trained-steps"
    yield learning_curves(curves, MASTERED, name, title, caption, against="Environment steps that trained")


def points_of(along: pd.DataFrame, ends: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return teacher, seed, step (or `END`) and value of every run, at every evaluation and at its end."""
    columns = ["teacher", "seed", "step", column]
    parts = [along[columns].astype({"step": object}), ends[[*columns[:2], column]].assign(step=END)]
    return pd.concat(parts, ignore_index=True).rename(columns={column: "value"})


def panels_of(
    frames: Frames, mine: Measured, curricula: Mapping[str, Curriculum], anchor: str
) -> Iterator[Chart]:
    """Yield charts of mastered test tasks, training tasks, probed tasks and teachers' logs."""
    if mine.finals.empty:
        return
    axes, which = task_axes(mine.cells), which_runs(curricula)
    for test_set, shares in _shares(frames, mine).groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        caption = (
            f"Share of seeds whose return on the task is over {thresholds(mine.cells)}, from faint for none "
            f"to strong for all, of the {len(tasks)} tasks of test set {test_set}; beside each name the "
            f"mean over tasks; {counts(mine.finals)}."
        )
        yield mastery_chart(shares, tasks, axes, f"{anchor}-mastery-{test_set}", caption)
    training = (
        f"{which}. Dots are training episodes of the latest fifth of it, at most {PAGE_EPISODES}, "
        f"coloured by return, from dark violet for falling at once to yellow for mastered."
    )
    probed = (
        f"{which}. Dots are tasks probed without exploration; outlines are the teacher's latest Gaussians, "
        f"at two standard deviations, and its boxes.{in_whose_space(curricula)}"
    )
    logs = f"{which}: what teachers log at their updates; bands show the range where points are dense."
    hidden = hidden_scalars(curricula)
    logs += f" {hidden} more are in the table teacher_log." if hidden else ""
    found = (
        training_tasks(curricula, axes, f"{anchor}-training-tasks", training),
        probed_tasks(curricula, axes, f"{anchor}-probed-tasks", probed),
        scalar_chart(curricula, f"{anchor}-teacher-log", logs),
    )
    yield from (chart for chart in found if chart is not None)


def pictures_of(mine: Measured, curricula: Mapping[str, Curriculum], anchor: str) -> Iterator[Picture]:
    """Yield the curricula dimension by dimension, where the task space is not a plane."""
    axes = task_axes(mine.cells)
    varied = sum(axis.low < axis.high for axis in axes)
    probed = {teacher: each for teacher, each in curricula.items() if len(each.probes)}
    whole_plane = len(axes) == varied == 2  # which charts show step by step
    if not 0 < varied <= LARGEST or whole_plane or len(moments(probed)) < 2:
        return
    caption = (
        f"{which_runs(curricula)}. Of the tasks probed without exploration: median, middle half and middle "
        f"90 %, dimension by dimension. Dark lines: bounds of the teacher's box, or two standard deviations "
        f"around its Gaussian; dots: means of several Gaussians, larger for more weight."
    )
    constant = len(axes) - varied
    if constant:
        caption += f" {constant} constant dimension{'s are' if constant > 1 else ' is'} left out."
    figure, title = draw(dimension_bands(probed, axes)), "Curriculum over training, dimension by dimension"
    name = f"{anchor}-curriculum-dimensions"
    yield Picture.of(name, figure, title, caption + in_whose_space(curricula))


def _shares(frames: Frames, mine: Measured) -> pd.DataFrame:
    """Return teacher, step (or `END`), test_set, task_index, n and share of seeds that master the task."""
    along = evaluations.mastered_tasks(frames, mine.evaluations, ["teacher", "step"]).astype({"step": object})
    ends = evaluations.mastered_tasks(frames, mine.finals, ["teacher"]).assign(step=END)
    return pd.concat([along, ends[along.columns]], ignore_index=True)


def end_rows(mine: Measured) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table at the ends of runs, Random first."""
    tests = {axis: mine.tests[mine.tests["measure"] == axis] for axis in AXES}
    groups: dict[str, Any] = {str(group["teacher"]): group for group in mine.summary.to_dict("records")}
    tested = {axis: table.set_index("teacher").to_dict("index") for axis, table in tests.items()}
    worst = mine.finals.groupby("teacher")[HEADLINE].min()
    for teacher in sorted(groups, key=teacher_order):
        group = groups[teacher]
        step = amount(group["step"]) if group["n"] else "\N{EN DASH}"
        yield {
            "name": teacher,
            "mean": float(group[f"{HEADLINE}_mean"]),
            "seeds": f"{group['n']}" if group["n"] == group["seeds"] else f"{group['n']} of {group['seeds']}",
            "step": step + "*" * bool(group["provisional"]),
            "mastered": plus_minus(group[f"{HEADLINE}_mean"], group[f"{HEADLINE}_std"]),
            "final": plus_minus(group[f"{FINAL}_mean"], group[f"{FINAL}_std"]),
            "worst": number(worst.get(teacher, math.nan)),
            "evaluation": plus_minus(group["evaluation_return_mean"], group["evaluation_return_std"]),
            "training": f"{number(group['first_quarter_mean'])} → {number(group['last_quarter_mean'])}",
            "provisional": group["provisional"],
            "verdict": "baseline" if is_baseline(teacher) else "not evaluated yet",
            **_against_random(tested, teacher),
        }


def best_of(section: Section) -> Mapping[str, Any] | None:
    """Return the row of the teacher that masters most over training, None if no run has ended or masters."""
    ended = [row for row in section.rows if row["mean"] > 0 and not row["provisional"]]
    return max(ended, key=lambda row: row["mean"], default=None)


def step_rows(mine: Measured, everything: Measured) -> dict[str, dict[str, dict[str, str]]]:
    """Return the rows at every evaluation, as text by step, teacher and column.

    Args:
        mine: measures of the comparison.
        everything: measures of the root, where Random may have run at another level or in another experiment.
    """
    curves = mine.evaluations
    if curves.empty:
        return {}
    reference = reference_of(curves, everything.randoms)
    tests = {axis: along_baseline(curves, reference, axis) for axis in AXES}
    tested = {axis: table.set_index(["step", "teacher"]).to_dict("index") for axis, table in tests.items()}

    columns = {"mastered": HEADLINE, "final": FINAL, "evaluation": "evaluation_return"}

    def row(step: int, teacher: str, rows: Columns) -> dict[str, str]:
        samples = {name: describe(rows[column]) for name, column in columns.items()}
        return {
            "seeds": str(len(set(rows["run_id"]))),
            "step": amount(step),
            "worst": number(rows[HEADLINE].min()),
            "training": "",
            "verdict": "baseline" if is_baseline(teacher) else "",
            **{name: plus_minus(sample.mean, sample.std) for name, sample in samples.items()},
            **_against_random(tested, (step, teacher)),
        }

    return by_step(curves[["step", "teacher", "run_id", *columns.values()]], row)


Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""Some rows of a table, column by column."""


def by_step(
    curves: pd.DataFrame, row: Callable[[int, str, Columns], dict[str, str]]
) -> dict[str, dict[str, dict[str, str]]]:
    """Return the result of `row` for the runs of each teacher at each step, by step and teacher."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    columns = {str(name): curves[name].to_numpy() for name in curves}
    groups: dict[Any, Any] = curves.groupby(["step", "teacher"]).indices
    for step, teacher in sorted(groups):
        rows = {name: values[groups[step, teacher]] for name, values in columns.items()}
        found.setdefault(str(int(step)), {})[str(teacher)] = row(int(step), str(teacher), rows)
    return found


def _against_random(tested: Mapping[str, Mapping[Any, Mapping[Any, Any]]], key: Hashable) -> dict[str, str]:
    """Return the cells of the tests with `key` on both axes; empty ones without tests."""
    tests = {axis: rows[key] for axis, rows in tested.items() if key in rows}
    if len(tests) < len(tested):
        return {"difference": "", "p": ""}
    test = tests[HEADLINE]
    words = on_both_axes(verdict(test), verdict(tests[FINAL]))
    if test["reason"]:
        return {"verdict": words, "difference": number(test["difference"]), "p": ""}
    p = p_value(test["holm"]).removeprefix("p").removeprefix(" = ").strip()
    return {"verdict": words, "difference": str(Gap.of(test)), "p": p}


def sections(frames: Frames, measured: Measured, shown: Collection[str]) -> Iterator[Section]:
    """Yield a section for each comparison of the root, in a fixed order.

    Args:
        frames: results of the root.
        measured: measures of the root.
        shown: teachers that figures have, which cannot be chosen on the page as charts can.
    """
    for anchor, title, mine in titled(measured):
        curricula = curricula_of(frames, mine)  # read once, for charts and figures
        leading = {teacher: each for teacher, each in curricula.items() if teacher in shown}
        ceiling = evaluations.ceiling_percent(frames, str(mine.cells["environment"].iloc[0]))
        first = mine.cells.iloc[0]
        charts = *charts_of(mine, anchor, ceiling), *trained_chart(frames, mine, anchor)
        yield Section(
            anchor=anchor,
            title=title,
            chosen_by={column: str(first[column]) for column in FILTERS},
            sentences=findings(mine.summary, mine.tests),
            rows=list(end_rows(mine)),
            step_rows=step_rows(mine, measured),
            points=points_of(mine.evaluations, mine.finals, HEADLINE),
            charts=list(map(on_page, charts)),
            panels=list(map(on_page, panels_of(frames, mine, curricula, anchor))),
            pictures=list(pictures_of(mine, leading, anchor)),
        )


def distinct(titles: Sequence[str]) -> list[str]:
    """Return titles without the parts, between commas, that all of them share."""
    parts = [title.split(", ") for title in titles]
    shared = set.intersection(*map(set, parts)) if parts else set()
    return [", ".join(part for part in each if part not in shared) or ", ".join(each) for each in parts]
