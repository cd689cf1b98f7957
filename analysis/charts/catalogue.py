"""Catalogue of the charts of a comparison of teachers, for pages and papers."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import pandas as pd

from analysis.charts.base import END, MASTERED, Chart
from analysis.charts.curricula import (
    Shot,
    curriculum_strip,
    dimension_bands,
    film,
    film_strip,
    hidden_scalars,
    scalar_chart,
    sheets,
)
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import seeds_chart
from analysis.charts.mastery import mastery_chart, mastery_map
from analysis.charts.tasks import PAGE_EPISODES, probed_tasks, projected, training_tasks
from analysis.comparisons.comparison import TeacherComparison
from analysis.data.curricula import Axis, RunCurriculum, curriculum_of, moments
from analysis.formatting import listed, number
from analysis.measures.evaluations import RECENT, aggregate, mastered_tasks
from analysis.measures.run_measures import NEARLY_ALL, trained_shares, with_trained_steps
from analysis.measures.tested import HEADLINE, PAPERS, QUANTITIES
from analysis.names import label, short_labels, teacher_order
from tma_ray.support.texts import counted

CURVES = (
    (PAPERS, MASTERED, "Mastered test tasks at each evaluation"),
    ("evaluation_return", "Mean return on the test set", "Return on the test set"),
    ("training_return", "Mean return of training episodes", "Return in training"),
)
"""Column, axis label and title of each chart of learning curves."""

MOST_DIMENSIONS = 20  # task spaces with more varied dimensions get no chart with a row per dimension


FILM_NAME_CHARS = 16  # maximum length of a teacher's name beside a row of a film strip


class PaperChart(NamedTuple):
    """Chart for papers: its file name, and the function that computes it."""

    name: str  # file name, unique within the comparison
    chart: Callable[[], Chart]  # function without arguments that returns the chart
    animated: bool = False  # True if the chart is saved as a GIF


def page_charts(comparison: TeacherComparison) -> Iterator[Chart]:
    """Yield the charts with all teachers in one panel: learning curves, seeds and trained steps."""
    for value, quantity, title in CURVES:
        table = comparison.training if value == "training_return" else comparison.evaluations
        if len(table):
            curves = aggregate(table, value, ["teacher"])
            name = f"{comparison.anchor}-{value.replace('_', '-')}"
            highest = comparison.ceiling if value == PAPERS else None
            yield learning_curves(curves, quantity, name, title, _curve_caption(value, table), highest)
    if len(comparison.finals):
        caption = f"Rings are seeds, marks their means with 95 % intervals; {_counts(comparison.finals)}."
        points = points_of(comparison.evaluations, comparison.finals, HEADLINE)
        name = f"{comparison.anchor}-seeds"
        yield seeds_chart(points, QUANTITIES[HEADLINE], name, "Seed by seed", caption)
    yield from trained_steps_chart(comparison)


def trained_steps_chart(comparison: TeacherComparison) -> Iterator[Chart]:
    """Yield curves against trained steps if any teacher trains on less than `NEARLY_ALL` % of its steps."""
    frames, evaluations = comparison.frames, comparison.evaluations
    teachers = evaluations.drop_duplicates("run_id").set_index("run_id")["teacher"]
    shares = trained_shares(frames).groupby(teachers.to_dict()).mean()
    fewer = shares[shares < NEARLY_ALL]
    if fewer.empty:
        return
    rows = with_trained_steps(frames, evaluations)
    trained = rows.groupby(["teacher", "step"], observed=True)["trained"].mean()
    curves = aggregate(rows, PAPERS, ["teacher"])
    keys = pd.MultiIndex.from_frame(curves[["teacher", "step"]])
    curves = curves.assign(step=trained.reindex(keys).to_numpy())
    parts = listed(f"{share:.0f} % of the steps of {label(str(teacher))}" for teacher, share in fewer.items())
    caption = (
        f"Without the steps of episodes that only score or try tasks: {parts} trained. "
        f"{_curve_caption(PAPERS, evaluations)}"
    )
    title = "Mastered test tasks against the steps that trained"
    name, axis = f"{comparison.anchor}-trained-steps", "Environment steps that trained"
    yield learning_curves(curves, MASTERED, name, title, caption, against=axis)


def page_panels(comparison: TeacherComparison) -> Iterator[Chart]:
    """Yield the charts with a panel per teacher: mastered tasks, training tasks, probed tasks, and logs."""
    if comparison.finals.empty:
        return
    frames, axes, curricula = comparison.frames, comparison.axes, comparison.curricula
    for test_set, shares in _shares(comparison).groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        caption = (
            f"Share of seeds whose return on the task is over {thresholds(comparison.cells)}, from faint for "
            f"none to strong for all, of the {len(tasks)} tasks of test set {test_set}; beside each name the "
            f"mean over tasks; {_counts(comparison.finals)}."
        )
        yield mastery_chart(shares, tasks, axes, f"{comparison.anchor}-mastery-{test_set}", caption)
    which = _which_runs(curricula)
    training = (
        f"{which}. Dots are training episodes of the latest fifth of it, at most {PAGE_EPISODES}, "
        f"coloured by return, from dark violet for falling at once to yellow for mastered."
    )
    probed = (
        f"{which}. Dots are tasks probed without exploration; outlines are the teacher's latest Gaussians, "
        f"at two standard deviations, and its boxes.{_whose_space(curricula)}"
    )
    logs = f"{which}: what teachers log at their updates; bands show the range where points are dense."
    hidden = hidden_scalars(curricula)
    logs += f" {hidden} more are in the table teacher_log." if hidden else ""
    charts = (
        training_tasks(curricula, axes, f"{comparison.anchor}-training-tasks", training),
        probed_tasks(curricula, axes, f"{comparison.anchor}-probed-tasks", probed),
        scalar_chart(curricula, f"{comparison.anchor}-teacher-log", logs),
    )
    yield from (chart for chart in charts if chart is not None)


def page_pictures(comparison: TeacherComparison) -> Iterator[Chart]:
    """Yield the chart of curricula with a row per task dimension, unless the task space is a plane."""
    axes, shown = comparison.axes, comparison.measurements.shown
    curricula = {teacher: each for teacher, each in comparison.curricula.items() if teacher in shown}
    probed = {teacher: each for teacher, each in curricula.items() if len(each.probes)}
    varied = sum(axis.low < axis.high for axis in axes)
    whole_plane = len(axes) == varied == 2  # other charts already show the tasks of a plane
    if not 0 < varied <= MOST_DIMENSIONS or whole_plane or len(moments(probed)) < 2:
        return
    caption = (
        f"{_which_runs(curricula)}. Of the tasks probed without exploration: median, middle half and middle "
        f"90 %, dimension by dimension. Dark lines: bounds of the teacher's box, or two standard deviations "
        f"around its Gaussian; dots: means of several Gaussians, larger for more weight."
    )
    constant = len(axes) - varied
    if constant:
        caption += f" {constant} constant dimension{'s are' if constant > 1 else ' is'} left out."
    yield replace(
        dimension_bands(probed, axes),
        name=f"{comparison.anchor}-curriculum-dimensions",
        title="Curriculum over training, dimension by dimension",
        caption=caption + _whose_space(curricula),
    )


def paper_charts(comparison: TeacherComparison) -> Iterator[PaperChart]:
    """Yield the charts for papers: maps of mastered tasks, and film strips and animations of curricula."""
    axes = comparison.axes
    varied = [index for index, axis in enumerate(axes) if axis.low < axis.high]
    if len(comparison.finals):
        tasks = comparison.frames.test_tasks
        plane = (axes[0], axes[1]) if len(axes) == 2 else None
        for test_set, shares in mastered_tasks(comparison.frames, comparison.finals).groupby("test_set"):
            chart = partial(mastery_map, shares, tasks[tasks["test_set"] == test_set], plane)
            yield PaperChart(f"mastery-{test_set}", chart)
    groups = sheets(list(comparison.median_runs))
    ends = [f"-{number}" if len(groups) > 1 else "" for number in range(1, len(groups) + 1)]
    for first, second in itertools.combinations(varied[:3], 2):
        dimensions = (first, second) if len(axes) > 2 else None
        suffix = "" if len(axes) == 2 else f"-{axes[first].name}-{axes[second].name}".replace(" ", "_")
        for end, teachers in zip(ends, groups, strict=True):
            shots_in = partial(_film, comparison, teachers, dimensions)
            yield PaperChart(f"film{suffix}{end}", partial(shots_in, film_strip))
            yield PaperChart(f"motion{suffix}{end}", partial(shots_in, film), animated=True)
    if len(axes) == len(varied) == 2:
        for end, teachers in zip(ends, groups, strict=True):
            yield PaperChart(f"training-tasks{end}", partial(_training_tasks, comparison, teachers))


def _film(
    comparison: TeacherComparison,
    teachers: Iterable[str],
    dimensions: tuple[int, int] | None,
    chart_of: Callable[[list[Shot], tuple[Axis, Axis]], Chart],
) -> Chart:
    names, shots = short_labels(teachers, FILM_NAME_CHARS), []
    for teacher in teachers:
        curriculum = curriculum_of(comparison.frames, comparison.median_runs[teacher])
        if len(curriculum.probes):
            shown = projected(curriculum, dimensions) if dimensions else curriculum
            shots.append(Shot(names[teacher], teacher, shown))
    first, second = dimensions or (0, 1)
    return chart_of(shots, (comparison.axes[first], comparison.axes[second]))


def _training_tasks(comparison: TeacherComparison, teachers: Iterable[str]) -> Chart:
    curricula = comparison.read_curricula(teachers)
    if not curricula:
        raise ValueError("no run has played an episode")
    return curriculum_strip(curricula, (comparison.axes[0], comparison.axes[1]))


def points_of(along: pd.DataFrame, ends: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the values of `column` at evaluations (`along`) and at the ends of runs (`ends`, step `END`)."""
    columns = ["teacher", "seed", "step", column]
    parts = [along[columns].astype({"step": object}), ends[[*columns[:2], column]].assign(step=END)]
    return pd.concat(parts, ignore_index=True).rename(columns={column: "value"})


def _shares(comparison: TeacherComparison) -> pd.DataFrame:
    """Return the share of runs that master each test task, by teacher and step (or `END`)."""
    frames = comparison.frames
    along = mastered_tasks(frames, comparison.evaluations, ["teacher", "step"]).astype({"step": object})
    ends = mastered_tasks(frames, comparison.finals, ["teacher"]).assign(step=END)
    return pd.concat([along, ends[along.columns]], ignore_index=True)


def _curve_caption(value: str, table: pd.DataFrame) -> str:
    """Return the caption of learning curves of `value`, a column of `table`."""
    text = f"Lines are means over seeds, bands ± one standard error of the mean; {_counts(table)}."
    if (table["status"] == "running").any():
        text += " Where some runs have yet to arrive, n is smaller."
    if value == "training_return":
        if table["smoothed"].any():
            text += f" A run counts with the mean of its latest {RECENT} episodes."
        text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
    return text


def _counts(rows: pd.DataFrame) -> str:
    """Format the number of runs per teacher, such as ``n = 4 seeds per teacher``."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    usual = int(counts.mode().iloc[-1])
    text = f"n = {counted(usual, 'seed')}" + (" per teacher" if len(counts) > 1 else "")
    others = [name for name in sorted(counts.index, key=teacher_order) if counts[name] != usual]
    if not others:
        return text
    return f"{text}, but {listed(f'{counts[name]} of {label(name)}' for name in others)}"


def thresholds(cells: pd.DataFrame) -> str:
    """Format the mastery thresholds of cells, such as ``230``."""
    return " or ".join(map(threshold, sorted(cells["mastery_threshold"].dropna().unique())))


def threshold(value: float) -> str:
    """Format a mastery threshold, without decimals if it is a whole number."""
    return number(value, 0 if value == round(value) else 2)


def _which_runs(curricula: Mapping[str, RunCurriculum]) -> str:
    """Return a clause that names the seed of each teacher's median run."""
    named = listed(f"{label(teacher)}: seed {curriculum.seed}" for teacher, curriculum in curricula.items())
    return f"One run of each teacher, the median one by mastered tasks over training ({named})"


def _whose_space(curricula: Mapping[str, RunCurriculum]) -> str:
    """Return a sentence about the axes if the task space is shuffled, else an empty string."""
    shuffled = any(curriculum.shuffled for curriculum in curricula.values())
    return " The task space is shuffled: axes are the teacher's, not the world's." if shuffled else ""
