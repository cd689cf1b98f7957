"""What is measured of a run: mastered test tasks, returns on the test set and in training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.frames import COMPARISON, GROUP, STATUSES, Frames
from analysis.statistics import Comparison, describe, holm, welch

BASELINE = "random"
"""The teacher that all others are tested against (paper, section 5)."""

NO_BASELINE = "no Random to compare with"
"""Why a teacher was not tested, when that is it."""

FEW_WINDOWS = 8
"""Below this number of training windows, training returns are read from the episodes."""

POINTS = 40
"""Points of a training curve that is read from the episodes."""

RECENT = 20
"""Episodes that each of these points is the mean of: the latest ones, fewer at the start."""


EPISODE_COLUMN = {"episodic_return": "training_return"}


def is_baseline(teacher: str) -> bool:
    """Tells whether `teacher` is the Random baseline."""
    return teacher.lower() == BASELINE


def evaluation_measures(evaluations: pd.DataFrame) -> pd.DataFrame:
    """Returns one row per run and evaluation: run_id, step, mastered_percent, evaluation_return, tasks.

    Rows of one evaluation mostly follow each other: they are added up before they are grouped, since a full
    benchmark has tens of millions.
    """
    run_ids, steps = evaluations["run_id"].astype("category"), evaluations["step"].to_numpy()
    codes = run_ids.cat.codes.to_numpy()
    change = (codes[1:] != codes[:-1]) | (steps[1:] != steps[:-1])
    starts = np.concatenate([[0], np.flatnonzero(change) + 1])[: len(steps)]
    table = pd.DataFrame(
        {
            "run_id": np.asarray(run_ids.cat.categories, dtype=object)[codes[starts]],
            "step": steps[starts],
            "mastered_percent": _sums(100.0 * evaluations["mastered"].to_numpy(), starts),
            "evaluation_return": _sums(evaluations["episodic_return"].to_numpy(float), starts),
            "tasks": np.diff(starts, append=len(steps)),
        }
    )
    sums = table.groupby(["run_id", "step"], sort=True).sum().reset_index()
    for measure in ("mastered_percent", "evaluation_return"):
        sums[measure] /= sums["tasks"]
    return sums.astype({"run_id": object})


def _sums(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.add.reduceat(values, starts) if len(starts) else np.zeros(0)


def readings(frames: Frames) -> pd.DataFrame:
    """Returns the evaluation that stands for each run: `GROUP`, seed, run_id, status, step, measures.

    A finished run is read at its last evaluation. A group in which no run has finished is read, and
    marked provisional, at the last step that all its running runs have reached. Failed runs are left
    out: where they stopped says nothing about the teacher.
    """
    rows = _alive(frames).merge(evaluation_measures(frames.evaluations), on="run_id")
    rows["provisional"] = ~_any_done(rows)
    rows = rows[rows["provisional"] | (rows["status"] == "done")]
    last = rows.groupby([*GROUP, "run_id"])["step"].transform("max")
    reached = last.groupby([rows[column] for column in GROUP]).transform("min")
    limit = last.where(~rows["provisional"], reached)
    rows = rows[rows["step"] <= limit].sort_values("step", kind="stable")
    rows = rows.drop_duplicates([*GROUP, "run_id"], keep="last").merge(training_quarters(frames), how="left")
    columns = [
        "step",
        "provisional",
        "mastered_percent",
        "evaluation_return",
        "first_quarter",
        "last_quarter",
    ]
    rows = rows[[*GROUP, "seed", "run_id", "status", *columns]]
    return rows.sort_values([*GROUP, "seed"], ignore_index=True)


def evaluation_curves(frames: Frames) -> pd.DataFrame:
    """Returns one row per run and evaluation with `GROUP`, of every run that did not fail."""
    return _alive(frames).merge(evaluation_measures(frames.evaluations), on="run_id")


def training_curves(frames: Frames) -> pd.DataFrame:
    """Returns `GROUP`, run_id, step, training_return and smoothed of every run that did not fail.

    From the training windows where a comparison has enough of them; else from the episodes, as the
    mean of the latest `RECENT` at `POINTS` steps.
    """
    windows, short = _windows(frames)
    episodes = frames.episode_returns(short["run_id"].unique().tolist()).astype({"run_id": object})
    runs = short.drop_duplicates("run_id")[["run_id", "steps", "status"]]
    recent = [_recent_returns(rows) for _, rows in episodes.merge(runs, on="run_id").groupby("run_id")]
    windows = windows.assign(smoothed=False)
    if not recent:
        return windows
    smooth = short.merge(pd.concat(recent), on="run_id").assign(smoothed=True)
    return pd.concat([windows, smooth], ignore_index=True)


def aggregate(curves: pd.DataFrame, value: str, by: Sequence[str] = GROUP) -> pd.DataFrame:
    """Returns `by`, step, n, mean, std and standard_error of `value` over the runs of a group."""
    grouped = curves.groupby([*by, "step"], sort=True)[value]
    table = grouped.agg(n="count", mean="mean", std="std").reset_index()
    return table.assign(standard_error=table["std"] / np.sqrt(table["n"]))


def mastered_tasks(frames: Frames, reading: pd.DataFrame) -> pd.DataFrame:
    """Returns `GROUP`, test_set, task_index, n and share: seeds that master each test task.

    Args:
        frames: where the evaluations are.
        reading: what `readings` returned; tells which evaluation counts for each run.
    """
    evaluations = frames.evaluations[frames.evaluations["step"].isin(reading["step"].unique())]
    evaluations = evaluations.astype({"run_id": object, "test_set": object})
    rows = reading[[*GROUP, "run_id", "step"]].merge(evaluations, on=["run_id", "step"])
    rows["share"] = rows["mastered"].astype(float)
    grouped = rows.groupby([*GROUP, "test_set", "task_index"], sort=True)["share"]
    return grouped.agg(n="count", share="mean").reset_index()


def training_quarters(frames: Frames) -> pd.DataFrame:
    """Returns run_id and the mean training return in the first and the last quarter of each run's steps."""
    windows, short = _windows(frames)
    episodes = frames.episode_returns(short["run_id"].unique().tolist()).astype({"run_id": object})
    rows = pd.concat(
        [windows.drop_duplicates(["run_id", "step"]), episodes.rename(columns=EPISODE_COLUMN)],
        ignore_index=True,
    )
    end = rows.groupby("run_id")["step"].transform("max")
    first = rows[rows["step"] <= end / 4].groupby("run_id")["training_return"].mean()
    last = rows[rows["step"] > end * 3 / 4].groupby("run_id")["training_return"].mean()
    return pd.DataFrame({"first_quarter": first, "last_quarter": last}).rename_axis("run_id").reset_index()


def summarise(frames: Frames, reading: pd.DataFrame) -> pd.DataFrame:
    """Returns one row per group: counts of runs by status, and mean and std of every measure."""
    rows = []
    for key, seeds in frames.cells.groupby(GROUP, sort=True):
        mine = reading[(reading[GROUP] == list(key)).all(axis=1)]
        row: dict[str, Any] = dict(zip(GROUP, key, strict=True))
        row |= {"seeds": seeds["run_id"].nunique(), "n": len(mine)}
        row |= {status: int((seeds["status"] == status).sum()) for status in STATUSES}
        row |= {"step": mine["step"].max(), "provisional": bool(mine["provisional"].any())}
        for measure in ("mastered_percent", "evaluation_return", "first_quarter", "last_quarter"):
            description = describe(mine[measure])
            row |= {f"{measure}_mean": description.mean, f"{measure}_std": description.std}
        rows.append(row)
    return pd.DataFrame(rows)


def against_baseline(reading: pd.DataFrame, curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns Welch's t-test of every teacher against Random, one row each, p and Holm's p by comparison.

    Where Random was run at another level of expert knowledge only, that one serves: it uses none.
    While runs are under way both are read at the same step, and the difference is not tested.

    Args:
        reading: what `readings` returned.
        curves: what `evaluation_curves` returned.
        measure: column of both.
    """
    rows = []
    for key, teachers in reading.groupby(COMPARISON, sort=True):
        reference = _reference(reading, teachers)
        for teacher in sorted(set(teachers["teacher"])):
            mine = teachers[teachers["teacher"] == teacher]
            if not is_baseline(teacher):
                step, comparison = _compare(mine, reference, curves, measure)
                names = dict(zip(COMPARISON, key, strict=True)) | {"teacher": teacher}
                rows.append(names | {"measure": measure, "step": step} | vars(comparison))
    table = pd.DataFrame(rows, columns=[*GROUP, "measure", "step", *Comparison.__dataclass_fields__])
    table["holm"] = table.groupby(COMPARISON)["p"].transform(holm)
    return table


def _compare(
    mine: pd.DataFrame, reference: pd.DataFrame, curves: pd.DataFrame, measure: str
) -> tuple[float, Comparison]:
    """Returns the step at which two groups are compared, and the comparison."""
    step, reason = min(mine["step"].max(), reference["step"].max()), ""
    if reference.empty:
        reason = NO_BASELINE
    elif mine["provisional"].any() or reference["provisional"].any():
        reason = "still running"
        now = curves[curves["step"] == step].drop_duplicates("run_id")
        mine, reference = (now[now["run_id"].isin(rows["run_id"])] for rows in (mine, reference))
    elif set(mine["step"]) != set(reference["step"]):
        reason = "trained for other numbers of steps"
    comparison = welch(*(rows.set_index("run_id")[measure] for rows in (mine, reference)))
    if reason:
        comparison = Comparison(comparison.n, comparison.reference_n, comparison.difference, reason=reason)
    return step, comparison


def _reference(reading: pd.DataFrame, teachers: pd.DataFrame) -> pd.DataFrame:
    """Returns Random's readings for one comparison, from another knowledge level if need be."""
    own = teachers[teachers["teacher"].map(is_baseline)]
    if len(own):
        return own
    columns = [column for column in COMPARISON if column != "expert_knowledge"]
    same = (reading[columns] == teachers[columns].iloc[0]).all(axis=1)
    return reading[same & reading["teacher"].map(is_baseline)].drop_duplicates("run_id")


def _alive(frames: Frames) -> pd.DataFrame:
    cells = frames.cells
    return cells.loc[cells["status"] != "failed", [*GROUP, "seed", "run_id", "status", "steps"]]


def _any_done(rows: pd.DataFrame) -> pd.Series:
    done = rows["status"] == "done"
    return done.groupby([rows[column] for column in GROUP]).transform("any")


def _windows(frames: Frames) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Returns the training windows of comparisons that have enough, and the cells of those that have not."""
    alive = _alive(frames)
    windows = frames.training[["run_id", "step", "mean_return"]].dropna().astype({"run_id": object})
    windows = alive.merge(windows.rename(columns={"mean_return": "training_return"}), on="run_id")
    counts = windows.groupby([*GROUP, "run_id"])["step"].size().groupby(COMPARISON).max()
    enough = counts[counts >= FEW_WINDOWS].index
    long_windows = windows[pd.MultiIndex.from_frame(windows[COMPARISON]).isin(enough)]
    return long_windows, alive[~pd.MultiIndex.from_frame(alive[COMPARISON]).isin(enough)]


def _recent_returns(episodes: pd.DataFrame) -> pd.DataFrame:
    """Returns run_id, step and training_return of one run, from its first episode on."""
    means = episodes["episodic_return"].rolling(RECENT, min_periods=1).mean().to_numpy()
    ends = episodes["step"].to_numpy()
    # The budget of a finished run ends inside an episode: its latest ones stand until then.
    run_id, budget, status = episodes[["run_id", "steps", "status"]].iloc[0]
    until = budget if status == "done" else ends[-1]
    steps = np.linspace(0, budget, POINTS + 1).round().astype("int64")
    steps = steps[(steps >= ends[0]) & (steps <= until)]
    latest = np.searchsorted(ends, steps, side="right") - 1
    return pd.DataFrame({"run_id": run_id, "step": steps, "training_return": means[latest]})
