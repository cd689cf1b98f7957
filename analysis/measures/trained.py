"""Trained steps (the steps that students learn from), and mastery per trained step."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames, computed_once, positions
from analysis.measures.evaluations import measured_so_far
from analysis.measures.tested import TRAINED

NEARLY_ALL = 95.0  # percentage of trained steps below which a teacher is also compared per trained step


@computed_once
def trained_steps(frames: Frames) -> pd.DataFrame:
    """Return the steps of each run that were trained up to the end of each training window.

    Steps of episodes that only score tasks are not trained. An episode counts to the window of its end.

    Returns:
        run_id, step, trained_steps, and trained_percent, their percentage of step.
    """
    windows = frames.training_returns.sort_values(["run_id", "step"]).astype({"run_id": object})
    steps = (windows["episodes"] * windows["mean_length"].fillna(0)).groupby(windows["run_id"]).cumsum()
    return windows[["run_id", "step"]].assign(
        trained_steps=steps, trained_percent=100 * steps / windows["step"]
    )


def trained_shares(frames: Frames) -> pd.Series:
    """Return the percentage of trained steps of each run, by run_id."""
    return trained_steps(frames).groupby("run_id")["trained_percent"].last()


def with_trained_steps(frames: Frames, curves: pd.DataFrame) -> pd.DataFrame:
    """Return `curves` with the trained steps at each step, without runs that lack training windows.

    Args:
        frames: results with training windows.
        curves: table with run_id, step and other columns.
    """
    windows = trained_steps(frames)
    ends, totals = windows["step"].to_numpy(float), windows["trained_steps"].to_numpy(float)
    by_run, steps = positions(windows["run_id"]), curves["step"].to_numpy(float)
    trained = np.full(len(curves), np.nan)
    for run_id, rows in positions(curves["run_id"]).items():
        if run_id in by_run:
            indices = by_run[run_id]
            trained[rows] = np.interp(steps[rows], [0, *ends[indices]], [0, *totals[indices]])
    return curves.assign(trained=trained).dropna(subset=["trained"])


Curves: TypeAlias = Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Trained steps and mastered % at the evaluations of each run, by run id."""


def trained_curves(frames: Frames) -> Curves:
    """Return the learning curves over trained steps of all runs with training windows."""
    table = with_trained_steps(frames, measured_so_far(frames))
    trained, mastered = table["trained"].to_numpy(float), table["mastered_percent"].to_numpy(float)
    return {run_id: (trained[rows], mastered[rows]) for run_id, rows in positions(table["run_id"]).items()}


def trained_areas(curves: Curves, runs: pd.DataFrame, teacher: str, strata: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with a column `TRAINED`: mean mastered % over as many trained steps as `teacher` has.

    The limit of a stratum is the fewest trained steps of a run of `teacher`; runs that end before it, and
    those without training windows, have no value.

    Args:
        curves: learning curves of `trained_curves`.
        runs: rows of `pooling.pool_runs`, of one level and budget.
        teacher: teacher that does not train on all steps.
        strata: columns of the strata's keys.
    """
    run_ids = runs["run_id"].to_numpy(object)
    totals = np.array([curves[run_id][0][-1] if run_id in curves else np.nan for run_id in run_ids])
    codes = runs.groupby(list(strata), dropna=False).ngroup().to_numpy()
    mask = (runs["teacher"] == teacher).to_numpy(bool) & ~np.isnan(totals)
    limits = np.full(codes.max(initial=-1) + 1, np.inf)
    np.minimum.at(limits, codes[mask], totals[mask])
    values = [
        _mean_until(*curves[run_id], limit) if limit <= total else np.nan
        for run_id, limit, total in zip(run_ids, limits[codes], totals, strict=True)
    ]
    return runs.assign(**{TRAINED: values})


def _mean_until(steps: NDArray[np.float64], mastered: NDArray[np.float64], limit: float) -> float:
    """Return the mean mastered % over the trained steps up to `limit`, by the trapezoidal rule."""
    inside = steps < limit
    ends = np.array([0.0, *steps[inside], limit])
    heights = np.array([mastered[0], *mastered[inside], np.interp(limit, steps, mastered)])
    return float((np.diff(ends) * (heights[1:] + heights[:-1])).sum() / 2 / limit)
