"""Steps from which students learned, and mastery for the same number of them."""

import numpy as np
import pandas as pd

from analysis.data.frames import Frames, computed_once
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
    windows = dict(list(trained_steps(frames).groupby("run_id")))
    parts = [
        each.assign(trained=np.interp(each["step"], [0, *known["step"]], [0, *known["trained_steps"]]))
        for run_id, each in curves.groupby("run_id", observed=True)
        if (known := windows.get(run_id)) is not None
    ]
    return pd.concat(parts) if parts else curves.head(0).assign(trained=0.0)


def trained_areas(frames: Frames, runs: pd.DataFrame, teacher: str, strata: list[str]) -> pd.DataFrame:
    """Return `runs` with `TRAINED`: mean of mastered % until as many trained steps as `teacher` has.

    In each stratum runs are measured until the number of trained steps of the run with the fewest; runs of
    other teachers with still fewer, and those without training windows, have no value.

    Args:
        frames: results with evaluations and windows of training.
        runs: rows of `pooling.pool_runs`, of one level and budget.
        teacher: teacher that does not train on all steps.
        strata: columns that tell the strata apart.
    """
    measured = measured_so_far(frames)
    measured = with_trained_steps(frames, measured[measured["run_id"].isin(runs["run_id"])])
    curves = dict(list(measured.groupby("run_id")[["trained", "mastered_percent"]]))
    ends = measured.groupby("run_id")["trained"].max()
    totals = runs["run_id"].map(ends)
    own = totals[runs["teacher"] == teacher].groupby([runs[column] for column in strata], dropna=False).min()
    until = (
        runs[strata].merge(own.rename("until").reset_index(), on=strata, how="left")["until"].to_numpy(float)
    )
    values = [
        _mean_until(curves[run_id], limit) if run_id in curves and limit <= total else np.nan
        for run_id, limit, total in zip(runs["run_id"], until, totals, strict=True)
    ]
    return runs.assign(**{TRAINED: values})


def _mean_until(curve: pd.DataFrame, limit: float) -> float:
    """Return the mean of mastered % over the trained steps until `limit`, by trapezoids."""
    steps, mastered = curve["trained"].to_numpy(float), curve["mastered_percent"].to_numpy(float)
    inside = steps < limit
    ends = np.array([0.0, *steps[inside], limit])
    heights = np.array([mastered[0], *mastered[inside], np.interp(limit, steps, mastered)])
    return float((np.diff(ends) * (heights[1:] + heights[:-1])).sum() / 2 / limit)
