"""Evaluations and training returns of runs: curves, final evaluations, mastered tasks, summaries."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.columns import COMPARISON, GROUP, RUN_CONDITIONS
from analysis.data.frames import STATUSES, Frames, check_columns, check_measure, computed_once, unfailed
from analysis.data.naming import of_searches, searches
from analysis.data.specs import parsed
from analysis.formatting import number
from analysis.statistics import describe
from tma_ray.support.component_names import base_name

FEW_WINDOWS = 8
"""Minimum number of windows for a training curve; with fewer, returns are read from the episodes."""

CURVE_POINTS = 40
"""Number of points of a training curve read from the episodes."""

RECENT = 20
"""Number of latest episodes averaged for each point of a training curve read from the episodes."""


@computed_once
def training_curves(frames: Frames) -> pd.DataFrame:
    """Return the training curves of runs that did not fail, excluding non-finite returns.

    The columns are those of `unfailed`, step, training_return and smoothed. Returns are those of the training
    windows or, smoothed, those of the episodes where a comparison has too few windows.
    """
    windows, short, episodes = _windows(frames)
    runs = short.drop_duplicates("run_id")[["run_id", "steps", "status"]]
    recent = [_recent_returns(rows) for _, rows in episodes.merge(runs, on="run_id").groupby("run_id")]
    windows = windows.assign(smoothed=False)
    if not recent:
        return windows
    smooth = short.merge(pd.concat(recent), on="run_id").assign(smoothed=True)
    return pd.concat([windows, smooth], ignore_index=True)


def training_quarters(frames: Frames) -> pd.DataFrame:
    """Return the mean training return in the first and the last quarter of each run."""
    windows, _, episodes = _windows(frames)
    episodes = episodes.rename(columns={"episodic_return": "training_return"})
    rows = pd.concat([windows.drop_duplicates(["run_id", "step"]), episodes], ignore_index=True)
    end = rows.groupby("run_id")["step"].transform("max")
    first = rows[rows["step"] <= end / 4].groupby("run_id")["training_return"].mean()
    last = rows[rows["step"] > end * 3 / 4].groupby("run_id")["training_return"].mean()
    return pd.DataFrame({"first_quarter": first, "last_quarter": last}).rename_axis("run_id").reset_index()


def _windows(frames: Frames) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Return training windows, and the cells and episodes of comparisons with too few windows."""
    alive = unfailed(frames.cells)
    windows = frames.training_returns[["run_id", "step", "mean_return"]].astype({"run_id": object})
    windows = windows[np.isfinite(windows["mean_return"].astype(float))]
    windows = alive.merge(windows.rename(columns={"mean_return": "training_return"}), on="run_id")
    counts = windows.groupby([*GROUP, "run_id"])["step"].size().groupby(COMPARISON).max()
    enough = counts[counts >= FEW_WINDOWS].index
    long_windows = windows[pd.MultiIndex.from_frame(windows[COMPARISON]).isin(enough)]
    short = alive[~pd.MultiIndex.from_frame(alive[COMPARISON]).isin(enough)]
    episodes = frames.episode_returns(short["run_id"].unique().tolist()).astype({"run_id": object})
    return long_windows, short, episodes


def _recent_returns(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return the training returns of one run, smoothed over the last `RECENT` episodes."""
    means = episodes["episodic_return"].rolling(RECENT, min_periods=1).mean().to_numpy()
    ends = episodes["step"].to_numpy()
    # a finished run keeps its last value up to the budget, which ends within an episode
    run_id, budget, status = episodes[["run_id", "steps", "status"]].iloc[0]
    until = budget if status == "done" else ends[-1]
    steps = np.linspace(0, budget, CURVE_POINTS + 1).round().astype("int64")
    steps = steps[(steps >= ends[0]) & (steps <= until)]
    latest = np.searchsorted(ends, steps, side="right") - 1
    return pd.DataFrame({"run_id": run_id, "step": steps, "training_return": means[latest]})


LAST = 3
"""Number of evaluations averaged in last_three."""

MEASURED = ["mastered_area", "last_three", "mastered_percent", "evaluation_return"]
"""Measures of a run up to an evaluation, the headline first."""


@computed_once
def measured_so_far(frames: Frames) -> pd.DataFrame:
    """Return the measures of each run up to each of its evaluations with finite returns.

    The columns are run_id, step and `MEASURED`.

    last_three is the mean of mastered_percent at the latest three evaluations, without that at step 0 unless
    it is the only one. mastered_area is the mean of mastered_percent over the steps: the area under the curve
    by trapezoids, with the first value extended to step 0.
    """
    curves = frames.measured[frames.measured["not_finite"] == 0].reset_index(drop=True)
    steps, mastered = curves["step"].to_numpy(float), curves["mastered_percent"].to_numpy(float)
    runs = curves["run_id"]
    before = curves.groupby("run_id", sort=False)[["step", "mastered_percent"]].shift()
    first = before["step"].isna().to_numpy()
    inner = (steps - before["step"]) * (mastered + before["mastered_percent"]) / 2
    area = inner.where(~first, steps * mastered).groupby(runs, sort=False).cumsum()
    trained = pd.Series(mastered).where(steps > 0).groupby(runs, sort=False)
    late = pd.concat([trained.shift(count) for count in range(LAST)], axis=1).mean(axis=1)
    return curves.assign(
        mastered_area=np.where(steps > 0, area / np.where(steps > 0, steps, 1.0), mastered),
        last_three=np.where(steps > 0, late, mastered),
    )[["run_id", "step", *MEASURED]]


def area_over(budget: pd.Series, ends: pd.DataFrame) -> pd.Series:
    """Return mastered_area over the whole budget of each run, holding the last mastered_percent to the end.

    Args:
        budget: steps of each run.
        ends: last row of each run from `measured_so_far`, with the same index.
    """
    share = ends["step"].astype(float) / budget
    return share * ends["mastered_area"] + (1 - share) * ends["mastered_percent"]


@computed_once
def final_evaluations(frames: Frames) -> pd.DataFrame:
    """Return the measures of each run at its final evaluation.

    A group without finished runs is read, and marked provisional, at the last step that all its runs have
    reached. Failed runs are left out, since their last step is arbitrary, and so are non-finite evaluations.

    Returns:
        `GROUP`, `RUN_CONDITIONS`, seed, run_id, status, step, provisional, `MEASURED`, first_quarter and
        last_quarter.
    """
    rows = unfailed(frames.cells).merge(frames.measured[["run_id", "step", "not_finite"]], on="run_id")
    groups = [rows[column] for column in GROUP]
    rows["provisional"] = ~rows["status"].eq("done").groupby(groups).transform("any")
    rows = rows[rows["provisional"] | (rows["status"] == "done")]
    last = rows.groupby([*GROUP, "run_id"])["step"].transform("max")
    reached = last.groupby([rows[column] for column in GROUP]).transform("min")
    limit = last.where(~rows["provisional"], reached)
    rows = rows[rows["step"] <= limit].sort_values("step", kind="stable")
    rows = rows.drop_duplicates([*GROUP, "run_id"], keep="last")
    rows = rows[rows["not_finite"] == 0].merge(measured_so_far(frames), on=["run_id", "step"])
    ended = ~rows["provisional"]
    rows["mastered_area"] = area_over(rows["steps"].astype(float).where(ended, rows["step"]), rows)
    rows = rows.merge(training_quarters(frames), how="left")
    columns = ["step", "provisional", *MEASURED, "first_quarter", "last_quarter"]
    rows = rows[[*GROUP, *RUN_CONDITIONS, "seed", "run_id", "status", *columns]]
    return rows.sort_values([*GROUP, "seed"], ignore_index=True)


@computed_once
def evaluation_curves(frames: Frames) -> pd.DataFrame:
    """Return the evaluations of runs that did not fail, excluding those with non-finite returns.

    The columns are those of `unfailed`, step and `MEASURED`.
    """
    return unfailed(frames.cells).merge(measured_so_far(frames), on="run_id")


@computed_once
def ceilings(frames: Frames) -> pd.DataFrame:
    """Return the number of tasks of each test set that any run masters, an upper bound for all teachers.

    Returns:
        environment, test_set, tasks (their number), ever (number mastered at any evaluation), last (number
        mastered at the last evaluation of any run), best_percent (best evaluation of a run, in %).
    """
    keys = ["environment", "test_set"]
    runs = unfailed(frames.cells)[["run_id", *keys]].drop_duplicates("run_id")
    rows = frames.evaluations_of(runs["run_id"].tolist())[["run_id", "step", "task_index", "mastered"]]
    rows = rows.astype({"run_id": object}).merge(runs, on="run_id")
    rows["last"] = rows["mastered"] & rows["step"].eq(rows.groupby("run_id")["step"].transform("max"))
    tasks = rows.groupby([*keys, "task_index"])[["mastered", "last"]].any().groupby(keys)
    best = rows.groupby([*keys, "run_id", "step"])["mastered"].mean().groupby(keys).max()
    table = tasks.sum().rename(columns={"mastered": "ever"})
    table = table.assign(tasks=tasks.size(), best_percent=100 * best).reset_index()
    return table[[*keys, "tasks", "ever", "last", "best_percent"]]


def ceiling_percent(frames: Frames, environment: str) -> float | None:
    """Return the percentage of an environment's test tasks that any run masters.

    The result is None unless the environment has exactly one test set in `frames`.
    """
    rows = ceilings(frames)
    rows = rows[rows["environment"] == environment]
    return float(100 * rows["ever"].iloc[0] / rows["tasks"].iloc[0]) if len(rows) == 1 else None


def ceiling_sentences(frames: Frames) -> list[str]:
    """Return sentences about how many test tasks any run masters, one per row of `ceilings`."""
    return [
        f"Ceiling: of the {row['tasks']} tasks of test set {row['test_set']}, {row['ever']} are mastered by "
        f"any run at any evaluation, {row['last']} at the last one; the best evaluation of a run masters "
        f"{number(row['best_percent'])} %."
        for row in ceilings(frames).to_dict("records")
    ]


def aggregate(curves: pd.DataFrame, value: str, by: Sequence[str] = GROUP) -> pd.DataFrame:
    """Return the mean and standard deviation of `value` over the runs of each group and step.

    Returns:
        `by`, step, n, mean, std, standard_error.
    """
    check_measure("curves", curves, value, [*by, "step"])
    grouped = curves.groupby([*by, "step"], sort=True)[value]
    table = grouped.agg(["count", "mean", "std"]).reset_index().rename(columns={"count": "n"})
    return table.assign(standard_error=table["std"] / np.sqrt(table["n"]))


def mastered_tasks(frames: Frames, finals: pd.DataFrame, by: Sequence[str] = GROUP) -> pd.DataFrame:
    """Return the share of runs that master each test task.

    Returns:
        `by`, test_set, task_index, n, share.
    """
    columns = list(dict.fromkeys([*by, "run_id", "step"]))
    check_columns("finals", finals, columns)
    evaluations = frames.evaluations_of(finals["run_id"].unique())
    evaluations = evaluations[evaluations["step"].isin(finals["step"].unique())]
    evaluations = evaluations.astype({"run_id": object, "test_set": object})
    rows = finals[columns].drop_duplicates().merge(evaluations, on=["run_id", "step"])
    grouped = rows.groupby([*by, "test_set", "task_index"], sort=True)["mastered"]
    return grouped.agg(n="count", share="mean").reset_index()


def summarise(frames: Frames, finals: pd.DataFrame) -> pd.DataFrame:
    """Return the number of runs by status, and mean and standard deviation of all measures, of each group."""
    rows, by_group = [], dict(list(finals.groupby(GROUP))) if len(finals) else {}
    for key, seeds in frames.cells.groupby(GROUP, sort=True):
        runs = by_group.get(key, finals.head(0))
        row: dict[str, Any] = dict(zip(GROUP, key, strict=True))
        row |= {"seeds": seeds["run_id"].nunique(), "n": len(runs)}
        row |= {status: int((seeds["status"] == status).sum()) for status in STATUSES}
        row |= {"step": runs["step"].max(), "provisional": bool(runs["provisional"].any())}
        for measure in (*MEASURED, "first_quarter", "last_quarter"):
            description = describe(runs[measure])
            row |= {f"{measure}_mean": description.mean, f"{measure}_std": description.std}
        rows.append(row)
    return pd.DataFrame(rows)


SEARCH_COLUMNS = ["searched", "experiment", "point", "chosen", "n", "mean", "std"]


def search_results(frames: Frames) -> pd.DataFrame:
    """Return the results of each finished point of all hyper-parameter searches, best first.

    Returns:
        searched (teacher or student), experiment, point (hyper-parameters, a dict), chosen (True for the
        paper's), n, mean and std of mastered tasks in per cent.
    """
    rows: list[list[Any]] = []
    if not of_searches(frames.cells["experiment"]).any():
        return pd.DataFrame(rows, columns=SEARCH_COLUMNS)
    finals = final_evaluations(frames)
    finals = finals[~finals["provisional"]]
    specs = frames.cells.drop_duplicates("run_id").set_index("run_id")["spec"]
    for matrix in searches():
        searched, grid = "teacher", matrix.teacher_grid
        if grid is None:
            searched, grid = "student", matrix.student_grid
        assert grid is not None
        members = finals[finals["experiment"].str.fullmatch(rf"{matrix.name}(_\d+)?")]
        for experiment, runs in members.groupby("experiment"):
            values = parsed(specs[runs["run_id"].iloc[0]]).get(f"{searched}_hyperparameters", {})
            point = {name: values.get(name) for name in grid.values}
            sample = describe(runs["mastered_percent"])
            name, chosen = base_name(runs[searched].iloc[0]), point == dict(grid.chosen)
            rows.append([name, experiment, point, chosen, sample.n, sample.mean, sample.std])
    table = pd.DataFrame(rows, columns=SEARCH_COLUMNS)
    return table.sort_values(["searched", "mean"], ascending=[True, False], kind="stable", ignore_index=True)
