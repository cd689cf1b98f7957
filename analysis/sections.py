"""One comparison of teachers as a section of the report: sentences, a table, figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from analysis.curriculum import PANELS, POINTS, Curriculum, curriculum_strip, stack
from analysis.figures import Axis, final_bars, learning_curve, mastery_map
from analysis.findings import amount, findings, number, p_value, plus_minus, verdict
from analysis.load import COMPARISON, Frames, parsed
from analysis.measures import is_baseline, mastered_tasks
from analysis.style import DPI, label, look, png, teacher_order
from tma_ray.benchmark import find_challenge


class Measures(NamedTuple):
    """What was measured over a whole root, as `analysis.measures` returned it."""

    readings: pd.DataFrame
    summary: pd.DataFrame
    tests: pd.DataFrame
    evaluations: pd.DataFrame
    training: pd.DataFrame

    def of(self, comparison: tuple[str, ...]) -> Measures:
        """Returns the rows of one comparison, named by the values of `COMPARISON`."""
        return Measures(*(table[(table[COMPARISON] == list(comparison)).all(axis=1)] for table in self))


@dataclass(frozen=True)
class Picture:
    """A figure of the report.

    Attributes:
        name: file name without its ending.
        png: the file.
        title: what it is, in a few words.
        caption: what is shown, of how many seeds.
        wide: whether it needs the full width of the page.
        width: its natural width on the page, CSS pixels.
    """

    name: str
    png: bytes
    title: str
    caption: str
    wide: bool
    width: int


@dataclass(frozen=True)
class Section:
    """One comparison.

    Attributes:
        anchor: identifier on the page.
        title: what is compared.
        sentences: what was found.
        rows: cells of the table, one row per teacher.
        pictures: its figures.
    """

    anchor: str
    title: str
    sentences: list[str]
    rows: list[dict[str, Any]]
    pictures: list[Picture]


def sections(frames: Frames, measures: Measures) -> Iterator[Section]:
    """Yields a section for each comparison of the root, in a fixed order."""
    comparisons = frames.cells[COMPARISON].drop_duplicates().sort_values(COMPARISON)
    for count, comparison in enumerate(comparisons.itertuples(index=False, name=None), start=1):
        mine = measures.of(comparison)
        anchor = f"comparison-{count}"
        yield Section(
            anchor=anchor,
            title=title(dict(zip(COMPARISON, comparison, strict=True)), frames.cells),
            sentences=findings(mine.summary, mine.tests),
            rows=_rows(mine),
            pictures=[_picture(f"{anchor}-{name}", *rest) for name, *rest in _figures(frames, mine, comparison)],
        )


def title(comparison: dict[str, str], cells: pd.DataFrame) -> str:
    """Returns what a comparison is about; the experiment only where there are several."""
    try:
        challenge = find_challenge(comparison["environment"], comparison["challenge"]).title
    except ValueError:  # somebody else's environment
        challenge = comparison["challenge"]
    parts = [
        comparison["environment"].replace("_", " ").capitalize(),
        challenge[:1].lower() + challenge[1:],
        comparison["embodiment"].replace("_", " "),
        comparison["student"].upper(),
        f"expert knowledge {comparison['expert_knowledge']}",
    ]
    if cells["experiment"].nunique() > 1:
        parts.insert(0, comparison["experiment"])
    return ", ".join(part for part in parts if part)


def _rows(mine: Measures) -> list[dict[str, Any]]:
    tests = mine.tests[mine.tests["measure"] == "mastered_percent"].set_index("teacher")
    by_teacher = mine.summary.set_index("teacher")
    return [_row(by_teacher.loc[name], tests) for name in sorted(by_teacher.index, key=teacher_order)]


def _row(group: pd.Series, tests: pd.DataFrame) -> dict[str, Any]:
    teacher = str(group.name)
    row = {
        "teacher": label(teacher),
        "colour": look(teacher).colour,
        "seeds": f"{group['n']}" if group["n"] == group["seeds"] else f"{group['n']} of {group['seeds']}",
        "step": amount(group["step"]) if group["n"] else "–",  # noqa: RUF001
        "mastered": plus_minus(group["mastered_percent_mean"], group["mastered_percent_std"]),
        "evaluation": plus_minus(group["evaluation_return_mean"], group["evaluation_return_std"]),
        "training": f"{number(group['first_quarter_mean'])} → {number(group['last_quarter_mean'])}",
        "provisional": group["provisional"],
        "difference": "",
        "p": "",
        "verdict": "baseline" if is_baseline(teacher) else "not evaluated yet",
    }
    if teacher in tests.index:
        test = tests.loc[teacher]
        row["verdict"] = verdict(test)
        row["difference"] = f"{number(test['difference'])}"
        if not test["reason"]:
            row["difference"] += f" [{number(test['low'])}, {number(test['high'])}]"
            row["p"] = p_value(test["p"]).removeprefix("p = ").removeprefix("p ")
    return row


def _picture(name: str, figure: Figure, title: str, caption: str) -> Picture:
    inches = figure.get_figwidth()
    return Picture(name, png(figure), title, caption, wide=inches > 6, width=round(inches * 100))


def _figures(
    frames: Frames, mine: Measures, comparison: tuple[str, ...]
) -> Iterator[tuple[str, Figure, str, str]]:
    """Yields name, figure, title and caption of what there is to draw."""
    counts = _counts(mine.readings)
    band = "Lines are means over seeds, bands ± one standard error of the mean"
    curves = (
        ("mastered_percent", mine.evaluations, "Mastered test tasks (%)", "Mastered test tasks over training"),
        ("evaluation_return", mine.evaluations, "Mean return on the test set", "Return on the test set"),
        ("training_return", mine.training, "Mean return of training episodes", "Return in training"),
    )
    for value, table, ylabel, name in curves:
        if len(table):
            text = f"{band}; {_counts(table)}."
            if value == "training_return":
                text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
            yield value.replace("_", "-"), learning_curve(table, value, ylabel), name, text
    if len(mine.readings):
        text = f"Bars are means, whiskers ± one standard deviation, dots single seeds; {counts}."
        yield "final-mastered", final_bars(mine.readings), "Mastered test tasks at the end", text
    plane = task_plane(frames, comparison)
    yield from _mastery(frames, mine, plane)
    if plane is not None:
        yield from _curricula(frames, mine, plane, comparison)


def _mastery(
    frames: Frames, mine: Measures, plane: tuple[Axis, Axis] | None
) -> Iterator[tuple[str, Figure, str, str]]:
    shares = mastered_tasks(frames, mine.readings)
    for test_set, rows in shares.groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        figure = mastery_map(rows, tasks, plane)
        text = (
            f"Share of seeds whose final return on the task is over 230, for the {len(tasks)} tasks of "
            f"test set {test_set}; beside each name the mean over tasks. {_counts(mine.readings)}."
        )
        yield f"mastery-{test_set}", figure, "Which test tasks are mastered", text


def _curricula(
    frames: Frames, mine: Measures, plane: tuple[Axis, Axis], comparison: tuple[str, ...]
) -> Iterator[tuple[str, Figure, str, str]]:
    curricula, seeds = {}, []
    for teacher, run in _examples(frames, mine, comparison).items():
        run_id = run["run_id"]
        tables = frames.episodes(run_id), frames.curriculum(run_id), frames.teacher_log(run_id)
        curriculum = Curriculum(*tables, steps=int(run["steps"]))
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == 2:
            curricula[teacher] = curriculum
            seeds.append(f"{label(teacher)}: seed {run['seed']}")
    if not curricula:
        return
    text = (
        f"One run of each teacher, the median one by mastered tasks ({', '.join(seeds)}), in {PANELS} equal "
        f"parts. Dots: training episodes, at most {POINTS} a panel, coloured by return; the white line in the "
        f"scale is mastery."
    )
    if any(curriculum.shuffled for curriculum in curricula.values()):
        text += " The task space is shuffled: dots show the tasks as they were built."
    else:
        text += (
            " Crosses: the last tasks probed without exploration. Outlines: the teacher’s last Gaussians "  # noqa: RUF001
            "(two standard deviations, heavier for more weight) or boxes."
        )
    yield "curriculum", curriculum_strip(curricula, plane), "Curriculum over training", text


def _examples(frames: Frames, mine: Measures, comparison: tuple[str, ...]) -> dict[str, pd.Series]:
    """Returns the run of each teacher that stands for it: the median reading, else its first that runs."""
    cells = frames.cells[(frames.cells[COMPARISON] == list(comparison)).all(axis=1)]
    cells = cells[cells["status"].isin(["done", "running"])].set_index("run_id", drop=False)
    chosen = {}
    for teacher, runs in cells.groupby("teacher"):
        readings = mine.readings[mine.readings["teacher"] == teacher]
        ranked = readings.sort_values(["mastered_percent", "evaluation_return"], kind="stable")["run_id"]
        run_id = ranked.iloc[(len(ranked) - 1) // 2] if len(ranked) else runs["run_id"].iloc[0]
        chosen[str(teacher)] = runs.loc[run_id]
    return chosen


def task_plane(frames: Frames, comparison: tuple[str, ...]) -> tuple[Axis, Axis] | None:
    """Returns the two dimensions that teachers choose from, None where there are more or it is unknown."""
    cells = frames.cells[(frames.cells[COMPARISON] == list(comparison)).all(axis=1)]
    for spec in cells["spec"].dropna():
        dimensions = parsed(spec).get("task_space", [])
        if len(dimensions) == 2:
            return _axis(dimensions[0]), _axis(dimensions[1])
        return None
    return None


def _axis(dimension: dict[str, Any]) -> Axis:
    name = str(dimension["name"]).replace("_", " ").capitalize()
    unit = f" ({dimension['unit']})" if dimension["unit"] else ""
    return Axis(name + unit, float(dimension["low"]), float(dimension["high"]))


def _counts(rows: pd.DataFrame) -> str:
    """Returns how many runs stand behind each teacher: ``n = 4 seeds``, or one number per teacher."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    if counts.nunique() == 1:
        count = counts.iloc[0]
        return f"n = {count} seed{'s' if count > 1 else ''}" + (" per teacher" if len(counts) > 1 else "")
    listed = [f"{counts[name]} ({label(name)})" for name in sorted(counts.index, key=teacher_order)]
    return f"n = {', '.join(listed)} seeds"
