"""Loading of results roots as `Frames`, and joining of several roots."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.columns import FROM_RUN, GROUP
from analysis.data.frames import STATUSES, Frames, named_runs, read_table, with_plain_texts
from analysis.data.naming import disambiguate_names, split_experiments
from analysis.data.specs import with_settings
from tma_ray.results import CHIPMUNK, Results, Table
from tma_ray.support.texts import counted


def load(root: str | Path) -> Frames:
    """Return the results of a root, finished or not; missing tables become empty, with a warning.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: if `root` is not a results root.
    """
    return frames_of(Results.open(root))


def frames_of(results: Results) -> Frames:
    """Return opened results as `Frames`; missing tables become empty, with a warning."""
    runs = with_settings(with_plain_texts(results.table(Table.RUNS).to_pandas()))
    cells = _join(with_plain_texts(read_table(results, Table.CELLS)), runs)
    cells, name_warnings = _named_cells(cells)
    columns = ["run_id", "step", "test_set", "task_index", "episodic_return"]
    evaluations = read_table(results, Table.EVALUATIONS, columns)
    evaluations["mastered"] = evaluations["episodic_return"] > _thresholds(evaluations, runs)
    measured = evaluation_measures(evaluations)
    # The tasks of a test set are the same in all runs, so those of one run are read.
    run_ids = evaluations.drop_duplicates("test_set")["run_id"].astype(str).tolist()
    tasks = with_plain_texts(
        read_table(results, Table.EVALUATIONS, ["test_set", "task_index", "task"], run_ids)
    )
    warnings = *_cell_warnings(cells, evaluations), *_evaluation_warnings(measured)
    return Frames(
        cells=cells.assign(core=True, budget_note=""),
        evaluations=evaluations,
        measured=measured,
        test_tasks=tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True),
        results=results,
        cell_warnings=(*warnings, *name_warnings),
    )


def _join(cells: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Join cells with the state of their runs, adding cells for runs that belong to no campaign."""
    alone = runs[~runs["run_id"].isin(cells["run_id"])]
    single = alone.reindex(columns=cells.columns).assign(campaign="", experiment="single runs")
    cells = pd.concat([cells, single], ignore_index=True) if len(single) else cells
    joined = cells.merge(runs[["run_id", *FROM_RUN]], on="run_id", how="left")
    # Cells without a run are waiting; only campaigns in Chipmunk's worlds have such cells.
    joined = joined.fillna({"engine": CHIPMUNK, "status": "waiting", "error": ""})
    # A cell listed by several campaigns counts once.
    return joined.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def joined(frames: Sequence[Frames]) -> Frames:
    """Join the runs of several roots, without duplicates and with unambiguous names.

    A run of several roots is read from the one in which it got furthest, or else from the first of them. If
    any root has a core, cells of roots without one are not of the core.
    """
    first, *others = frames
    if not others:
        return first
    ranks: dict[str, tuple[int, int]] = {}
    for root, each in enumerate(frames):
        for run_id, status in each.cells[["run_id", "status"]].itertuples(index=False, name=None):
            rank = STATUSES.index(status), root
            ranks[run_id] = min(rank, ranks.get(run_id, rank))
    roots = {run_id: root for run_id, (_, root) in ranks.items()}
    cells, name_warnings = _named_cells(_joined_cells(frames, roots))
    tables = {
        name: pd.concat(
            [
                table[(table["run_id"].astype(object).map(roots) == root).to_numpy(bool)]
                for root, table in enumerate(getattr(each, name) for each in frames)
            ],
            ignore_index=True,
        )
        for name in ("evaluations", "measured")
    }
    test_tasks = pd.concat([each.test_tasks for each in frames], ignore_index=True)
    warnings = [text for each in frames for text in each.cell_warnings]
    warnings += [*_cell_warnings(cells, tables["evaluations"]), *name_warnings]
    core = [campaign for each in frames for campaign in each.core]
    return Frames(
        cells=cells,
        **tables,
        test_tasks=test_tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True),
        results=first.results,
        cell_warnings=tuple(dict.fromkeys(warnings)),
        other_roots={run_id: frames[root].results_of(run_id) for run_id, root in roots.items() if root},
        core=tuple(dict.fromkeys(core)),
    )


def _joined_cells(frames: Sequence[Frames], roots: Mapping[str, int]) -> pd.DataFrame:
    """Return the cells of all frames, with the state of each run in the root from which it is read."""
    any_core = any(each.core for each in frames)
    parts = [
        each.cells.assign(root=root, core=each.cells["core"] & (bool(each.core) or not any_core))
        for root, each in enumerate(frames)
    ]
    cells = pd.concat(parts, ignore_index=True)
    is_read = cells["root"] == cells["run_id"].map(roots)
    if not is_read.all():
        state = cells[is_read].drop_duplicates("run_id").set_index("run_id")[FROM_RUN]
        cells[FROM_RUN] = cells[FROM_RUN].astype(object)  # to preserve integers of any size
        cells.loc[~is_read, FROM_RUN] = state.loc[cells.loc[~is_read, "run_id"]].to_numpy(object)
    cells = cells.drop(columns="root").infer_objects()
    return cells.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def _named_cells(cells: pd.DataFrame) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Make names and experiments of cells unambiguous; return cells and a sentence about each new name."""
    (cells,), names = disambiguate_names([cells])
    cells, experiments = split_experiments(with_plain_texts(cells))
    return cells, (*names, *experiments)


def _thresholds(evaluations: pd.DataFrame, runs: pd.DataFrame) -> pd.Series | float:
    """Return the mastery threshold of each row of `evaluations`, or a single number if all are equal."""
    thresholds = runs["mastery_threshold"].unique()
    if len(thresholds) == 1:
        return float(thresholds[0])
    return evaluations["run_id"].map(runs.set_index("run_id")["mastery_threshold"]).astype(float)


def evaluation_measures(evaluations: pd.DataFrame) -> pd.DataFrame:
    """Return the measures of each evaluation of a run, with the columns run_id, step, tasks and not_finite.

    An evaluation with NaN or infinite returns (their number is not_finite) has NaN measures: mastered_percent
    is of all test tasks, and such a return is neither a failure nor a success.

    Rows of one evaluation, with run_id, step, episodic_return and mastered (bool), mostly follow each other.
    They are added up before they are grouped, since a full benchmark has tens of millions.
    """
    run_ids, steps = evaluations["run_id"].astype("category"), evaluations["step"].to_numpy()
    codes = run_ids.cat.codes.to_numpy()
    change = (codes[1:] != codes[:-1]) | (steps[1:] != steps[:-1])
    starts = np.concatenate([[0], np.flatnonzero(change) + 1])[: len(steps)]
    returns = evaluations["episodic_return"].to_numpy(float)
    finite = np.isfinite(returns)

    def sums(values: NDArray[np.number]) -> NDArray[np.number]:
        return np.add.reduceat(values, starts) if len(starts) else np.zeros(0, values.dtype)

    table = pd.DataFrame(
        {
            "run_id": np.asarray(run_ids.cat.categories, dtype=object)[codes[starts]],
            "step": steps[starts],
            "mastered_percent": sums(100.0 * evaluations["mastered"].to_numpy()),
            "evaluation_return": sums(returns if finite.all() else np.where(finite, returns, 0.0)),
            "tasks": np.diff(starts, append=len(steps)),
            "not_finite": sums((~finite).astype(np.int64)),
        }
    )
    table = table.groupby(["run_id", "step"], sort=True).sum().reset_index()
    for measure in ("mastered_percent", "evaluation_return"):
        table[measure] = (table[measure] / table["tasks"]).where(table["not_finite"] == 0)
    return table.astype({"run_id": object})


def _cell_warnings(cells: pd.DataFrame, evaluations: pd.DataFrame) -> list[str]:
    """Return warnings about missing results, and about results of several engines."""
    sentences = []
    if cells.empty:
        sentences.append("This root holds no runs yet.")
    elif evaluations.empty:
        sentences.append("No evaluation has finished yet, so there is nothing to compare.")
    engines = sorted(cells["engine"].unique())
    if len(engines) > 1:
        names = ", ".join(engines)
        sentences.append(f"Runs of different engines ({names}) stand apart and are never compared.")
    return sentences


def _evaluation_warnings(measured: pd.DataFrame) -> list[str]:
    """Return a warning about evaluations with NaN or infinite returns, if there are any."""
    excluded = measured[measured["not_finite"] > 0]
    if excluded.empty:
        return []
    return [
        f"{excluded['not_finite'].sum():,} returns of {counted(len(excluded), 'evaluation')} are NaN or "
        f"infinite; these evaluations are excluded ({named_runs(excluded['run_id'])})."
    ]
