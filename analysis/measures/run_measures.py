"""Measures of single runs: mastered tasks, steps until given shares are mastered, forgetting, training."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames, computed_once, positions
from analysis.measures.evaluations import MEASURED, area_over, measured_so_far, training_curves
from analysis.measures.tested import TRAINED
from tma_ray.support.quantities import SHARE, STEP
from tma_ray.support.validation import check_sequence

NOT_FINITE = "returns not finite"
"""Reason for missing measures: the last evaluation has NaN or infinite returns."""


SHARES = (0.5, 0.9)
"""Shares of the finally mastered tasks for which the first step that reaches them is measured."""


def measure_names(shares: Sequence[float] = SHARES) -> list[str]:
    """Return the names of the measures of `run_measures`, in order."""
    return [*MEASURED, *map(steps_to, shares), "forgotten_percent", "training_return"]


def steps_to(share: float) -> str:
    """Return the column of `run_measures` for the first step at `share` of the finally mastered tasks."""
    return f"steps_to_{round(100 * share)}_percent"


@computed_once
def run_measures(
    frames: Frames,
    at: int | None = None,
    shares: Sequence[float] = SHARES,
    share: float = 1.0,
    *,
    training: bool = True,
) -> pd.DataFrame:
    """Return the measures of each run at the end of its budget, or after a share of it.

    Args:
        frames: results with runs, evaluations and training windows.
        at: number of steps after which runs are measured, as if that were their budget; None for each run's
            own budget.
        shares: shares of the final mastered_percent, each with a column `steps_to`.
        share: share of each run's own budget after which it is measured.
        training: True for a column training_return, which needs more files.

    Returns:
        Rows sorted by run_id, with the columns

        - run_id, steps (at which it is measured), step (of the last evaluation until then);
        - `evaluations.MEASURED` at that evaluation, with mastered_area over the whole budget;
        - steps_to_50_percent and so on: step of the first evaluation with this share of the final
          mastered_percent; NaN if that is 0;
        - forgotten_percent: % of test tasks mastered at an earlier evaluation and not at the last;
        - training_return: mean over training episodes;
        - reason for missing measures, which are NaN: "waiting", "failed", "still running", "not evaluated",
          "ends before", `NOT_FINITE`; else empty.
    """
    STEP.check("at", 0 if at is None else at)
    check_sequence("shares", shares)
    for value in (*shares, share):
        SHARE.check("share", value)
    measured, evaluations = frames.measured, frames.evaluations
    rows = _limits(frames, at, _reached(frames, measured), share)
    within = _until(measured, rows)
    curves = within[within["not_finite"] == 0]
    ends = within.drop_duplicates("run_id", keep="last").set_index("run_id")
    rows["step"] = ends["step"]
    rows.loc[(rows["reason"] == "") & rows["step"].isna(), "reason"] = "not evaluated"
    broken = ends["not_finite"].reindex(rows.index, fill_value=0) > 0
    rows.loc[(rows["reason"] == "") & broken, "reason"] = NOT_FINITE
    last = measured_so_far(frames).merge(ends["step"].reset_index(), on=["run_id", "step"])
    rows = rows.join(last.set_index("run_id")[MEASURED])
    rows["mastered_area"] = area_over(rows["steps"], rows)
    rows = rows.join(_steps_to(curves, shares))
    evaluations = _until(evaluations, rows) if len(within) < len(measured) else evaluations
    rows["forgotten_percent"] = _forgotten(evaluations, within)
    measures = [name for name in measure_names(shares) if training or name != "training_return"]
    if training:
        rows["training_return"] = _training_return(frames, rows[rows["reason"] == ""])
    rows.loc[rows["reason"] != "", measures] = np.nan
    return rows.reset_index()[["run_id", "steps", "step", *measures, "reason"]]


@computed_once
def evaluations_at(frames: Frames, steps: Iterable[int]) -> pd.DataFrame:
    """Return the measures at given steps of all runs that reached them and did not fail.

    Returns:
        step (one of `steps`), run_id, evaluated_at (step of the last evaluation until then), and
        `evaluations.MEASURED`.
    """
    check_sequence("steps", steps)
    steps = list(steps)
    for step in steps:
        STEP.check("step", step)
    curves = frames.measured[["run_id", "step"]].merge(measured_so_far(frames), how="left")
    rows = _latest(frames, curves.rename(columns={"step": "evaluated_at"}), "evaluated_at", sorted(steps))
    return rows[["step", "run_id", "evaluated_at", *MEASURED]]


def training_returns_at(frames: Frames, steps: Iterable[int]) -> pd.DataFrame:
    """Return the training returns at given steps of all runs that reached them and did not fail.

    Returns:
        step (one of `steps`), run_id, training_return (last value of `evaluations.training_curves`).
    """
    curves = training_curves(frames)[["run_id", "step", "training_return"]].rename(
        columns={"step": "measured_at"}
    )
    rows = _latest(frames, curves.drop_duplicates(["run_id", "measured_at"]), "measured_at", sorted(steps))
    return rows[["step", "run_id", "training_return"]]


def _latest(frames: Frames, curves: pd.DataFrame, measured: str, steps: Sequence[int]) -> pd.DataFrame:
    """Return the last row of `curves` up to each of `steps`, for every run that reached that step."""
    reached = _reached(frames, frames.measured)
    limits = [_limits(frames, step, reached).assign(step=step) for step in steps]
    rows = pd.concat([_limits(frames, 0, reached).head(0).assign(step=0), *limits]).reset_index()
    rows = rows.loc[rows["reason"] == "", ["step", "run_id"]].astype({"step": "int64", "run_id": object})
    curves = curves.sort_values(measured, kind="stable")
    rows = pd.merge_asof(rows, curves, left_on="step", right_on=measured, by="run_id")
    return rows[rows[measured].notna()].reset_index(drop=True)


def _until(table: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `table` up to the step at which their run is measured, as given by `rows`."""
    return table[table["step"] <= table["run_id"].map(rows["steps"]).astype(float)]


def _reached(frames: Frames, curves: pd.DataFrame) -> pd.Series:
    """Return the step of each run's last evaluation by run_id, or NaN if it was never evaluated."""
    runs = sorted(frames.cells["run_id"].unique())
    return curves.groupby("run_id")["step"].max().reindex(runs).astype(float)


def _limits(frames: Frames, at: int | None, reached: pd.Series, share: float = 1.0) -> pd.DataFrame:
    """Return, by run_id, the step at which each run is measured and any reason why it cannot be."""
    runs = frames.cells.drop_duplicates("run_id").set_index("run_id").sort_index()
    status, budget = runs["status"], runs["steps"].astype(float)
    steps = np.floor(share * budget) if at is None else pd.Series(float(at), index=runs.index)
    reason = pd.Series("", index=runs.index, dtype=object)
    complete = reached >= steps if at is not None or share < 1 else False
    reason[status.eq("running") & ~pd.Series(complete, index=runs.index)] = "still running"
    reason[budget < steps] = "ends before"
    for word in ("waiting", "failed"):
        reason[status == word] = word
    return pd.DataFrame({"steps": steps, "reason": reason})


def _steps_to(curves: pd.DataFrame, shares: Sequence[float]) -> pd.DataFrame:
    steps_by_run: dict[str, list[float]] = {}
    run_ids, steps = curves["run_id"].to_numpy(object), curves["step"].to_numpy(float)
    mastered = curves["mastered_percent"].to_numpy(float)
    starts = np.flatnonzero(np.append(True, run_ids[1:] != run_ids[:-1])) if len(curves) else np.zeros(0, int)
    for first, end in itertools.pairwise([*starts, len(curves)]):  # slices are faster than a frame per run
        curve, final = mastered[first:end], mastered[end - 1]
        reached = (steps[first + np.argmax(curve >= share * final)] if final else np.nan for share in shares)
        steps_by_run[str(run_ids[first])] = list(map(float, reached))
    columns = [*map(steps_to, shares)]
    return pd.DataFrame.from_dict(steps_by_run, orient="index", columns=columns, dtype=float)


def _forgotten(evaluations: pd.DataFrame, measured: pd.DataFrame) -> pd.Series:
    """Return the percentage of test tasks mastered before but not at the last evaluation, by run_id."""
    mastered = evaluations.loc[evaluations["mastered"], ["run_id", "task_index", "step"]]
    broken = measured.loc[measured["not_finite"] > 0, ["run_id", "step"]]
    if len(broken):
        rows = pd.MultiIndex.from_arrays([mastered["run_id"].astype(object), mastered["step"]])
        mastered = mastered[~rows.isin(pd.MultiIndex.from_frame(broken))]
    ends = measured.drop_duplicates("run_id", keep="last").set_index("run_id")
    at_end = mastered[mastered["step"] == mastered["run_id"].map(ends["step"]).astype(float)]
    counts = [
        part.drop_duplicates(["run_id", "task_index"]).groupby("run_id", observed=True).size()
        for part in (mastered, at_end)
    ]
    ever, last = (c.set_axis(c.index.astype(object)).reindex(ends.index, fill_value=0) for c in counts)
    return 100.0 * (ever - last) / ends["tasks"]


def _training_return(frames: Frames, rows: pd.DataFrame) -> pd.Series:
    windows = frames.training_returns.dropna()
    windows = _until(windows[np.isfinite(windows["mean_return"].astype(float))], rows)
    windows = windows.astype({"run_id": object})
    totals = windows.assign(total=windows["mean_return"] * windows["episodes"]).groupby("run_id")
    means = totals["total"].sum() / totals["episodes"].sum()
    short = rows.index.difference(means.index)
    if not len(short):
        return means
    episodes = _until(frames.episode_returns(short.tolist()).astype({"run_id": object}), rows)
    return pd.concat([means, episodes.groupby("run_id")["episodic_return"].mean()])


NEARLY_ALL = 95.0  # teachers that train on a smaller percentage of steps are also compared per trained step


@computed_once
def trained_steps(frames: Frames) -> pd.DataFrame:
    """Return the number of trained steps of each run, up to the end of each training window.

    Steps of episodes that only score tasks are not trained. An episode counts in the window in which it ends.

    Returns:
        run_id, step, trained_steps, and trained_percent, their percentage of step.
    """
    windows = frames.training_returns.sort_values(["run_id", "step"]).astype({"run_id": object})
    steps = (windows["episodes"] * windows["mean_length"].fillna(0)).groupby(windows["run_id"]).cumsum()
    return windows[["run_id", "step"]].assign(
        trained_steps=steps, trained_percent=100 * steps / windows["step"]
    )


def trained_shares(frames: Frames) -> pd.Series:
    """Return the percentage of its steps on which each run trained, by run_id."""
    return trained_steps(frames).groupby("run_id")["trained_percent"].last()


def with_trained_steps(frames: Frames, curves: pd.DataFrame) -> pd.DataFrame:
    """Add a column with the trained steps up to each step, dropping runs that lack training windows.

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
"""Trained steps and mastered_percent at the evaluations of each run, by run id."""


def trained_curves(frames: Frames) -> Curves:
    """Return learning curves against trained steps, for all runs with training windows."""
    table = with_trained_steps(frames, measured_so_far(frames))
    trained, mastered = table["trained"].to_numpy(float), table["mastered_percent"].to_numpy(float)
    return {run_id: (trained[rows], mastered[rows]) for run_id, rows in positions(table["run_id"]).items()}


def trained_areas(curves: Curves, runs: pd.DataFrame, teacher: str, strata: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with the mean percentage of mastered tasks up to a limit of trained steps, as `TRAINED`.

    The limit of a stratum is the fewest trained steps of a run of `teacher`; runs that end before it, and
    those without training windows, have no value.

    Args:
        curves: learning curves from `trained_curves`.
        runs: rows from `pooling.pool_runs`, of one level and budget.
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
    """Return the mean percentage of mastered tasks over `limit` trained steps, by the trapezoidal rule."""
    inside = steps < limit
    ends = np.array([0.0, *steps[inside], limit])
    heights = np.array([mastered[0], *mastered[inside], np.interp(limit, steps, mastered)])
    return float((np.diff(ends) * (heights[1:] + heights[:-1])).sum() / 2 / limit)
