"""Result tables of one root or of several as pandas frames, ready to group by cell; checks of tables."""

import functools
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data import identity
from analysis.data.columns import FROM_RUN, GROUP, RUN_CONDITIONS
from tma_ray.results import CHIPMUNK, SCHEMAS, Results, Table
from tma_ray.support.texts import counted
from tma_ray.support.validation import check_known, check_sequence, check_type

OF_ONE_RUN = {
    Table.EPISODES: ["step", "episode", "task", "world_task", "episodic_return"],
    Table.CURRICULUM: ["step", "sample", "task"],
    Table.TEACHER_LOG: ["step", "gaussians", "boxes", "scalars"],
}
"""Columns that are read of the long tables of single runs; tasks are float32 (d,)."""

RETURNS = ["run_id", "step", "episodes", "mean_return", "mean_length"]
"""Columns that views read of the windows of training: of thousands of small files each column takes time."""


P = ParamSpec("P")

SHOWN_RUNS = 3
"""Runs that a message names."""

STATUSES = ("done", "running", "failed", "waiting")
"""States of the run of a cell; waiting is a cell whose run has not started."""


@dataclass(frozen=True)
class Frames:
    """The results of one root; large tables are read on first use.

    Attributes:
        cells: one row per cell and run: `GROUP`, campaign, seed, run_id, status, error, spec, steps,
            test_set, physics_version, and of the spec `FROM_SPEC`: engine (what simulated the worlds),
            mastery_threshold, settings and identity. core is True in the campaigns of `core`. Names that
            would mean several things are split: see `identity.disambiguate_names`.
        evaluations: run_id, step, test_set, task_index, episodic_return, and mastered: whether that
            is over the threshold of its run.
        measured: one row per run and evaluation, of `evaluation_measures`: computed once.
        test_tasks: test_set, task_index, task (float32 (d,)).
        told: warnings on cells and evaluations, to be read before trusting a comparison.
        results: source of the long tables.
        elsewhere: sources of the long tables of runs that another of several joined roots holds, by run id.
        core: campaigns whose teachers are compared in a family of their own; empty for all.
    """

    cells: pd.DataFrame
    evaluations: pd.DataFrame
    measured: pd.DataFrame
    test_tasks: pd.DataFrame
    results: Results = field(repr=False)
    told: tuple[str, ...] = ()
    elsewhere: Mapping[str, Results] = field(default_factory=dict, repr=False)
    core: tuple[str, ...] = ()
    _computed: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for readers of a comparison, on evaluations and training."""
        return (*self.told, *training_warnings(self.training_returns))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sentences on requested files that could not be read."""
        places = {id(each): each for each in (self.results, *self.elsewhere.values())}.values()
        return tuple(dict.fromkeys(text for each in places for text in each.problems))

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, and sentences on files that were left out."""
        return (*self.warnings, *self.left_out)

    @functools.cached_property
    def training(self) -> pd.DataFrame:
        """Windows of training of all runs, as stored."""
        return self._rows(Table.TRAINING, SCHEMAS[Table.TRAINING].names, self._run_ids)

    @functools.cached_property
    def training_returns(self) -> pd.DataFrame:
        """The columns `RETURNS` of the windows of training, which is all that views need of them."""
        if "training" in vars(self):
            return self.training[RETURNS]
        return self._rows(Table.TRAINING, RETURNS, self._run_ids)

    @functools.cached_property
    def attempts(self) -> pd.DataFrame:
        """Attempts at all runs, as stored."""
        return self._rows(Table.ATTEMPTS, SCHEMAS[Table.ATTEMPTS].names, self._run_ids)

    @property
    def run_hours(self) -> pd.Series:
        """Wall-clock time of each run, all its attempts together, in hours, by run id; empty if unknown."""
        attempts = self.attempts
        return attempts["wall_seconds"].astype(float).groupby(attempts["run_id"].astype(str)).sum() / 3600

    @property
    def _run_ids(self) -> list[str]:
        return list(self.cells["run_id"].unique())

    def with_core(self, campaigns: Sequence[str]) -> "Frames":
        """Return the same results with a core of `campaigns`, or of all if there are none."""
        core = self.cells["campaign"].isin(campaigns) if campaigns else True
        return replace(self, cells=self.cells.assign(core=core), core=tuple(campaigns))

    def results_of(self, run_id: str) -> Results:
        """Return the results that hold a run."""
        return self.elsewhere.get(run_id, self.results)

    def episode_returns(self, run_ids: Sequence[str]) -> pd.DataFrame:
        """Return run_id, step and finite episodic_return of the training episodes of `run_ids`."""
        columns = ["run_id", "step", "episodic_return"]
        check_sequence("run_ids", run_ids)
        rows = self._rows(Table.EPISODES, columns, run_ids)
        return rows[np.isfinite(rows["episodic_return"].astype(float))]

    def episodes(self, run_id: str) -> pd.DataFrame:
        """Return the training episodes of one run, tasks as float32 (d,)."""
        return self.of_runs(Table.EPISODES, [run_id])[run_id]

    def curriculum(self, run_id: str) -> pd.DataFrame:
        """Return the probed tasks of one run, tasks as float32 (d,)."""
        return self.of_runs(Table.CURRICULUM, [run_id])[run_id]

    def teacher_log(self, run_id: str) -> pd.DataFrame:
        """Return step, gaussians, boxes and scalars of every update of the teacher of one run."""
        return self.of_runs(Table.TEACHER_LOG, [run_id])[run_id]

    def of_runs(self, table: Table, run_ids: Sequence[str]) -> dict[str, pd.DataFrame]:
        """Return the columns `OF_ONE_RUN` of a long table for each of `run_ids`, read together."""
        columns = OF_ONE_RUN[table]
        rows = self._rows(table, ["run_id", *columns], run_ids)
        places, kept = positions(rows["run_id"]), rows[columns]
        none = np.zeros(0, np.int64)
        return {run_id: kept.take(places.get(run_id, none)).reset_index(drop=True) for run_id in run_ids}

    def evaluations_of(self, run_ids: Collection[str]) -> pd.DataFrame:
        """Return the evaluations of some runs, without searching those of all."""
        mine = [self._evaluated[run_id] for run_id in run_ids if run_id in self._evaluated]
        return self.evaluations.take(np.concatenate([np.zeros(0, np.int64), *mine]))

    @functools.cached_property
    def _evaluated(self) -> dict[str, NDArray[np.int64]]:
        return positions(self.evaluations["run_id"])

    def _rows(self, table: Table, columns: list[str], run_ids: Sequence[str]) -> pd.DataFrame:
        """Read a long table of some runs, from whichever files hold them."""
        known = set(self._run_ids)
        for run_id in run_ids:
            check_type("run_id", run_id, str, "the id of one run")
            if run_id not in known:
                check_known("run", run_id, self._run_ids[:SHOWN_RUNS], "the first ones are")
        places: dict[int, tuple[Results, list[str]]] = {}
        for run_id in run_ids:
            results = self.results_of(run_id)
            places.setdefault(id(results), (results, []))[1].append(run_id)
        parts = [_frame(results, table, columns, mine) for results, mine in places.values()]
        if len(parts) == 1:
            return parts[0]
        return pd.concat(parts, ignore_index=True) if parts else _frame(self.results, table, columns, [])


def computed_once(
    function: Callable[Concatenate[Frames, P], pd.DataFrame],
) -> Callable[Concatenate[Frames, P], pd.DataFrame]:
    """Wrap `function` so that it computes each frame once per `Frames`; every caller gets a copy."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def compute(frames: Frames, /, *args: P.args, **kwargs: P.kwargs) -> pd.DataFrame:
        check_type("frames", frames, Frames, "what analysis.load returns")
        given = signature.bind(frames, *args, **kwargs)
        given.apply_defaults()
        values = list(given.arguments.values())[1:]
        key = (function, *(tuple(each) if isinstance(each, list) else each for each in values))
        if key not in frames._computed:
            frames._computed[key] = function(frames, *args, **kwargs)
        found: pd.DataFrame = frames._computed[key]
        return found.copy()

    return compute


def load(root: str | Path) -> Frames:
    """Read a root, finished or not; what is missing becomes an empty frame and a warning.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: no results root at that place.
    """
    return frames_of(Results.open(root))


def frames_of(results: Results) -> Frames:
    """Return the frames of opened results; what is missing becomes an empty frame and a warning."""
    runs = identity.with_settings(with_plain_texts(results.table(Table.RUNS).to_pandas()))
    (cells,), split = identity.disambiguate_names(
        [_join(with_plain_texts(_frame(results, Table.CELLS)), runs)]
    )
    cells, apart = identity.split_experiments(with_plain_texts(cells.assign(core=True)))
    columns = ["run_id", "step", "test_set", "task_index", "episodic_return"]
    evaluations = _frame(results, Table.EVALUATIONS, columns)
    evaluations["mastered"] = evaluations["episodic_return"] > identity.thresholds_of(evaluations, runs)
    measured = evaluation_measures(evaluations)
    # The tasks of a test set are the same in all runs: one that met it is read.
    witnesses = evaluations.drop_duplicates("test_set")["run_id"].astype(str).tolist()
    tasks = with_plain_texts(
        _frame(results, Table.EVALUATIONS, ["test_set", "task_index", "task"], witnesses)
    )
    told = *cell_warnings(cells, evaluations), *evaluation_warnings(measured)
    return Frames(
        cells=cells,
        evaluations=evaluations,
        measured=measured,
        test_tasks=tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True),
        results=results,
        told=(*told, *split, *apart),
    )


def positions(run_ids: pd.Series) -> dict[str, NDArray[np.int64]]:
    """Return the rows of each run in a table, in order, by run id; `run_ids` has one for each row (n,)."""
    known = run_ids.astype("category").cat
    order = np.argsort(known.codes.to_numpy(), kind="stable")
    ends = np.cumsum(np.bincount(known.codes, minlength=len(known.categories)))
    return dict(zip(known.categories, np.split(order, ends[:-1]), strict=True)) if len(ends) else {}


def unfailed(cells: pd.DataFrame) -> pd.DataFrame:
    """Return `GROUP`, `RUN_CONDITIONS`, seed, run_id and status of the cells whose runs did not fail."""
    return cells.loc[cells["status"] != "failed", [*GROUP, *RUN_CONDITIONS, "seed", "run_id", "status"]]


def _frame(
    results: Results, table: Table, columns: list[str] | None = None, run_ids: Sequence[str] | None = None
) -> pd.DataFrame:
    """Read a table with its strings as categories: run ids repeat millions of times."""
    content = results.table(table, run_ids=None if run_ids is None else set(run_ids), columns=columns)
    frame: pd.DataFrame = content.to_pandas(strings_to_categorical=True)
    return frame


def _join(cells: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Join cells with the state of their runs; runs outside any campaign are cells of their own."""
    alone = runs[~runs["run_id"].isin(cells["run_id"])]
    single = alone.reindex(columns=cells.columns).assign(campaign="", experiment="single runs")
    cells = pd.concat([cells, single], ignore_index=True) if len(single) else cells
    joined = cells.merge(runs[["run_id", *FROM_RUN]], on="run_id", how="left")
    # Only campaigns of ours have runs that wait.
    joined = joined.fillna({"engine": CHIPMUNK, "status": "waiting", "error": ""})
    # Two campaigns on one root may list the same cell: its runs count once.
    return joined.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def cell_warnings(cells: pd.DataFrame, evaluations: pd.DataFrame) -> list[str]:
    """Return sentences on missing results, and on engines that stand apart."""
    found = []
    if cells.empty:
        found.append("This root holds no runs yet.")
    elif evaluations.empty:
        found.append("No evaluation has finished yet, so there is nothing to compare.")
    engines = sorted(cells["engine"].unique())
    if len(engines) > 1:
        found.append(f"Runs of different engines ({', '.join(engines)}) stand apart and are never compared.")
    return found


def joined(frames: Sequence[Frames]) -> Frames:
    """Return the runs of several roots as those of one: named together, every run once.

    A name that means different things in different roots is split, as within a root. A run that several
    roots have is read where it got furthest, in the first of them if it is finished in several. Where any of
    them has a core, cells of those without one are not of the core.
    """
    first, *others = frames
    if not others:
        return first
    ranks: dict[str, tuple[int, int]] = {}
    for place, each in enumerate(frames):
        for run_id, status in each.cells[["run_id", "status"]].itertuples(index=False, name=None):
            rank = STATUSES.index(status), place
            ranks[run_id] = min(rank, ranks.get(run_id, rank))
    places = {run_id: place for run_id, (_, place) in ranks.items()}
    (cells,), split = identity.disambiguate_names([_joined_cells(frames, places)])
    cells, apart = identity.split_experiments(with_plain_texts(cells))
    tables = {
        name: pd.concat(
            [
                table[(table["run_id"].astype(object).map(places) == place).to_numpy(bool)]
                for place, table in enumerate(getattr(each, name) for each in frames)
            ],
            ignore_index=True,
        )
        for name in ("evaluations", "measured")
    }
    test_tasks = pd.concat([each.test_tasks for each in frames], ignore_index=True)
    of_each = [text for each in frames for text in each.told]
    told = (*of_each, *cell_warnings(cells, tables["evaluations"]), *split, *apart)
    core = [campaign for each in frames for campaign in each.core]
    return Frames(
        cells=cells,
        **tables,
        test_tasks=test_tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True),
        results=first.results,
        told=tuple(dict.fromkeys(told)),
        elsewhere={run_id: frames[place].results_of(run_id) for run_id, place in places.items() if place},
        core=tuple(dict.fromkeys(core)),
    )


def _joined_cells(frames: Sequence[Frames], places: Mapping[str, int]) -> pd.DataFrame:
    """Return the cells of all, each with the state of its run where that is read."""
    any_core = any(each.core for each in frames)
    parts = [
        each.cells.assign(place=place, core=each.cells["core"] & (bool(each.core) or not any_core))
        for place, each in enumerate(frames)
    ]
    cells = pd.concat(parts, ignore_index=True)
    here = cells["place"] == cells["run_id"].map(places)
    if not here.all():
        state = cells[here].drop_duplicates("run_id").set_index("run_id")[FROM_RUN]
        cells[FROM_RUN] = cells[FROM_RUN].astype(object)  # whole numbers of any width fit then
        cells.loc[~here, FROM_RUN] = state.loc[cells.loc[~here, "run_id"]].to_numpy(object)
    cells = cells.drop(columns="place").infer_objects()
    return cells.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def check_columns(name: str, table: object, columns: Sequence[str]) -> None:
    """Refuse the argument `name` if it is not a table with these columns.

    Raises:
        TypeError: it is not a table, or `columns` is one text.
        ValueError: it lacks a column; the message holds the nearest one.
    """
    check_type(name, table, pd.DataFrame, "a table, as from analysis.runs_after(frames)")
    check_sequence("columns", columns)
    assert isinstance(table, pd.DataFrame)
    for column in columns:
        check_known("column", column, table.columns, f"{name} has")


def check_measure(name: str, table: object, measure: str, columns: Sequence[str]) -> None:
    """Refuse anything but a table with `columns` and the numbers of a `measure`.

    Raises:
        TypeError: errors of `check_columns`.
        ValueError: it lacks a column, or `measure` is none of numbers.
    """
    check_columns(name, table, [measure, *columns])
    assert isinstance(table, pd.DataFrame)
    values = table[measure].dropna()
    if len(values) and not pd.api.types.is_numeric_dtype(values.infer_objects()):
        raise ValueError(f"column {measure!r} is not a measure: {values.iloc[0]!r} is not a number")


def with_plain_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Return `frame` with its texts and categories as Python strings, missing ones as they are.

    Names are few and short, and tables are grouped by a dozen of them again and again: pandas takes and
    groups Arrow's strings several times more slowly than objects, and merging unequal categories is fragile.
    """
    kinds = pd.CategoricalDtype | pd.StringDtype  # pandas 2 has no "str" to select by
    return frame.astype({name: object for name, dtype in frame.dtypes.items() if isinstance(dtype, kinds)})


def evaluation_measures(evaluations: pd.DataFrame) -> pd.DataFrame:
    """Return one row per run and evaluation: run_id, step, the measures, tasks, and not_finite.

    An evaluation that has any return that is NaN or infinite has no measures (NaN): mastered % is of all test
    tasks, and a missing return is neither a failure nor a success. not_finite is the number of such returns.

    Rows of one evaluation, with run_id, step, episodic_return and mastered (bool), mostly follow each other:
    they are added up before they are grouped, since a full benchmark has tens of millions.
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
    found = table.groupby(["run_id", "step"], sort=True).sum().reset_index()
    for measure in ("mastered_percent", "evaluation_return"):
        found[measure] = (found[measure] / found["tasks"]).where(found["not_finite"] == 0)
    return found.astype({"run_id": object})


def evaluation_warnings(measured: pd.DataFrame) -> list[str]:
    """Return a sentence on the returns that are NaN or infinite in rows of `evaluation_measures`."""
    excluded = measured[measured["not_finite"] > 0]
    if excluded.empty:
        return []
    return [
        f"{excluded['not_finite'].sum():,} returns of {counted(len(excluded), 'evaluation')} are NaN or "
        f"infinite; these evaluations are excluded ({_named(excluded['run_id'])})."
    ]


def training_warnings(training: pd.DataFrame) -> list[str]:
    """Return a sentence on the windows of training whose mean return is NaN or infinite."""
    windows = training[training["mean_return"].notna() & ~np.isfinite(training["mean_return"].astype(float))]
    nans = training[training["mean_return"].isna() & (training["episodes"] > 0)]
    if not len(windows) + len(nans):
        return []
    runs = pd.concat([windows["run_id"], nans["run_id"]]).astype(str)
    return [
        f"{counted(len(windows) + len(nans), 'window')} of training with a mean return that is NaN or "
        f"infinite: excluded ({_named(runs)})."
    ]


def _named(run_ids: pd.Series) -> str:
    runs = sorted(set(run_ids))
    more = f" and {len(runs) - SHOWN_RUNS} more" if len(runs) > SHOWN_RUNS else ""
    return f"{counted(len(runs), 'run')}: {', '.join(runs[:SHOWN_RUNS])}{more}"
