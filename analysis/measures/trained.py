"""Steps from which students learned, and mastery for the same number of them."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames, computed_once, positions
from analysis.measures.evaluations import measured_so_far
from analysis.measures.tested import TRAINED

NEARLY_ALL = 95.0
"""Per cent of its steps under which a teacher is also compared per trained step."""


@computed_once
def trained_steps(frames: Frames) -> pd.DataFrame:
    """Return run_id, step, trained_steps and trained_percent (of step) at the end of each training window.

    Episodes that only score tasks, or try them, spend steps from which the student does not learn. An episode
    counts to the window in which it ends.
    """
    windows = frames.training_returns.sort_values(["run_id", "step"]).astype({"run_id": object})
    steps = (windows["episodes"] * windows["mean_length"].fillna(0)).groupby(windows["run_id"]).cumsum()
    return windows[["run_id", "step"]].assign(
        trained_steps=steps, trained_percent=100 * steps / windows["step"]
    )


def trained_shares(frames: Frames) -> pd.Series:
    """Return the per cent of its steps from which the student of each run learned, by run_id."""
    return trained_steps(frames).groupby("run_id")["trained_percent"].last()


def with_trained_steps(frames: Frames, curves: pd.DataFrame) -> pd.DataFrame:
    """Return `curves` with the trained steps at each step, of the runs that have windows of training.

    Args:
        frames: results with windows of training.
        curves: run_id and step, among other columns.
    """
    windows = trained_steps(frames)
    ends, trained = windows["step"].to_numpy(float), windows["trained_steps"].to_numpy(float)
    own, steps = positions(windows["run_id"]), curves["step"].to_numpy(float)
    found = np.full(len(curves), np.nan)
    for run_id, rows in positions(curves["run_id"]).items():
        if run_id in own:
            known = own[run_id]
            found[rows] = np.interp(steps[rows], [0, *ends[known]], [0, *trained[known]])
    return curves.assign(trained=found).dropna(subset=["trained"])


Curves: TypeAlias = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Trained steps and mastered % at the evaluations of runs, by run id."""


def trained_curves(frames: Frames) -> Curves:
    """Return the learning curves of the runs with windows of training against their trained steps."""
    table = with_trained_steps(frames, measured_so_far(frames))
    trained, mastered = table["trained"].to_numpy(float), table["mastered_percent"].to_numpy(float)
    return {run_id: (trained[rows], mastered[rows]) for run_id, rows in positions(table["run_id"]).items()}


def trained_areas(curves: Curves, runs: pd.DataFrame, teacher: str, strata: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with `TRAINED`: mean of mastered % until as many trained steps as `teacher` has.

    In each stratum runs are measured until the number of trained steps of the run with the fewest; runs of
    other teachers with still fewer, and those without windows of training, have no value.

    Args:
        curves: learning curves of `trained_curves`.
        runs: rows of `pooling.pool_runs`, of one level and budget.
        teacher: teacher that does not train on all steps.
        strata: columns that tell the strata apart.
    """
    run_ids = runs["run_id"].to_numpy(object)
    totals = np.array([curves[each][0][-1] if each in curves else np.nan for each in run_ids])
    codes = runs.groupby(list(strata), dropna=False).ngroup().to_numpy()
    own = (runs["teacher"] == teacher).to_numpy(bool) & ~np.isnan(totals)
    until = np.full(codes.max(initial=-1) + 1, np.inf)
    np.minimum.at(until, codes[own], totals[own])
    values = [
        _mean_until(*curves[run_id], limit) if limit <= total else np.nan
        for run_id, limit, total in zip(run_ids, until[codes], totals, strict=True)
    ]
    return runs.assign(**{TRAINED: values})


def _mean_until(steps: NDArray[np.float64], mastered: NDArray[np.float64], limit: float) -> float:
    """Return the mean of mastered % over the trained steps until `limit`, by trapezoids."""
    inside = steps < limit
    ends = np.array([0.0, *steps[inside], limit])
    heights = np.array([mastered[0], *mastered[inside], np.interp(limit, steps, mastered)])
    return float((np.diff(ends) * (heights[1:] + heights[:-1])).sum() / 2 / limit)
