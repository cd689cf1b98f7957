"""Evaluations of runs: curves, final evaluations, mastered test tasks, and summaries over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import GROUP, STATUSES, Frames, unfailed
from analysis.measures.training import training_quarters
from analysis.statistics import describe


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


def final_evaluations(frames: Frames) -> pd.DataFrame:
    """Returns the evaluation that stands for each run: `GROUP`, seed, run_id, status, step, measures.

    A finished run is read at its last evaluation. A group in which no run has finished is read, and
    marked provisional, at the last step that all its running runs have reached. Failed runs are left
    out: where they stopped says nothing about the teacher.
    """
    rows = unfailed(frames.cells).merge(evaluation_measures(frames.evaluations), on="run_id")
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
    return unfailed(frames.cells).merge(evaluation_measures(frames.evaluations), on="run_id")


def aggregate(curves: pd.DataFrame, value: str, by: Sequence[str] = GROUP) -> pd.DataFrame:
    """Returns `by`, step, n, mean, std and standard_error of `value` over the runs of a group."""
    grouped = curves.groupby([*by, "step"], sort=True)[value]
    table = grouped.agg(n="count", mean="mean", std="std").reset_index()
    return table.assign(standard_error=table["std"] / np.sqrt(table["n"]))


def mastered_tasks(frames: Frames, finals: pd.DataFrame) -> pd.DataFrame:
    """Returns `GROUP`, test_set, task_index, n and share: seeds that master each test task.

    Args:
        frames: where the evaluations are.
        finals: what `final_evaluations` returned; tells which evaluation counts for each run.
    """
    evaluations = frames.evaluations[frames.evaluations["step"].isin(finals["step"].unique())]
    evaluations = evaluations.astype({"run_id": object, "test_set": object})
    rows = finals[[*GROUP, "run_id", "step"]].merge(evaluations, on=["run_id", "step"])
    rows["share"] = rows["mastered"].astype(float)
    grouped = rows.groupby([*GROUP, "test_set", "task_index"], sort=True)["share"]
    return grouped.agg(n="count", share="mean").reset_index()


def summarise(frames: Frames, finals: pd.DataFrame) -> pd.DataFrame:
    """Returns one row per group: counts of runs by status, and mean and std of every measure."""
    rows = []
    for key, seeds in frames.cells.groupby(GROUP, sort=True):
        mine = finals[(finals[GROUP] == list(key)).all(axis=1)]
        row: dict[str, Any] = dict(zip(GROUP, key, strict=True))
        row |= {"seeds": seeds["run_id"].nunique(), "n": len(mine)}
        row |= {status: int((seeds["status"] == status).sum()) for status in STATUSES}
        row |= {"step": mine["step"].max(), "provisional": bool(mine["provisional"].any())}
        for measure in ("mastered_percent", "evaluation_return", "first_quarter", "last_quarter"):
            description = describe(mine[measure])
            row |= {f"{measure}_mean": description.mean, f"{measure}_std": description.std}
        rows.append(row)
    return pd.DataFrame(rows)


def _any_done(rows: pd.DataFrame) -> pd.Series:
    done = rows["status"] == "done"
    return done.groupby([rows[column] for column in GROUP]).transform("any")
