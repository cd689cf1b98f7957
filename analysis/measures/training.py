"""Returns in training: curves, and quarters of a run."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.data.frames import COMPARISON, GROUP, Frames, computed_once, unfailed

FEW_WINDOWS = 8
"""Below this number of training windows, training returns are read from the episodes."""

POINTS = 40
"""Points of a training curve that is read from the episodes."""

RECENT = 20
"""Episodes that each of these points is the mean of: the latest ones, fewer at the start."""

EPISODE_COLUMN = {"episodic_return": "training_return"}


@computed_once
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


def _windows(frames: Frames) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Returns the training windows of comparisons that have enough, and the cells of those that have not."""
    alive = unfailed(frames.cells)
    windows = frames.training_returns[["run_id", "step", "mean_return"]].astype({"run_id": object})
    windows = windows[np.isfinite(windows["mean_return"].astype(float))]
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
