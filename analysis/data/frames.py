"""Results as pandas frames, and checks of tables."""

import functools
import inspect
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Concatenate, ParamSpec

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.columns import GROUP, RUN_CONDITIONS
from tma_ray.results import SCHEMAS, Results, Table
from tma_ray.support.texts import counted
from tma_ray.support.validation import check_known, check_sequence, check_type

OF_ONE_RUN = {
    Table.EPISODES: ["step", "episode", "task", "world_task", "episodic_return"],
    Table.CURRICULUM: ["step", "sample", "task"],
    Table.TEACHER_LOG: ["step", "gaussians", "boxes", "scalars"],
}
"""Columns of the long tables that are read for single runs; tasks are float32 (d,)."""

WINDOW_COLUMNS = ["run_id", "step", "episodes", "mean_return", "mean_length"]
"""Training-window columns that views use; reading more from thousands of small files takes time."""

SHOWN_RUNS = 3
"""Largest number of runs named in a message."""

STATUSES = ("done", "running", "failed", "waiting")
"""States of a cell's run; "waiting" if it has not started."""

P = ParamSpec("P")


@dataclass(frozen=True)
class Frames:
    """Results of one root or of several joined roots, with large tables read on first use.

    Attributes:
        cells: one row per cell and run: `GROUP`, campaign, seed, run_id, status, error, spec, steps,
            test_set, physics_version, and `FROM_SPEC`; engine is the simulator of the worlds. core is True
            in the campaigns of `core`; budget_note is that of the baseline, if any. Ambiguous names are split
            by `naming.disambiguate_names`.
        evaluations: run_id, step, test_set, task_index, episodic_return, and mastered, True if that is over
            the threshold of its run.
        measured: one row per run and evaluation, from `loading.evaluation_measures`.
        test_tasks: test_set, task_index, task (float32 (d,)).
        cell_warnings: warnings about cells and evaluations, to be read before trusting a comparison.
        results: source of the long tables.
        other_roots: sources of the long tables of runs that are not in `results`, by run id.
        core: campaigns whose teachers are compared in a family of their own; empty for all.
    """

    cells: pd.DataFrame
    evaluations: pd.DataFrame
    measured: pd.DataFrame
    test_tasks: pd.DataFrame
    results: Results = field(repr=False)
    cell_warnings: tuple[str, ...] = ()
    other_roots: Mapping[str, Results] = field(default_factory=dict, repr=False)
    core: tuple[str, ...] = ()
    _computed: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about evaluations and training, for readers of a comparison."""
        return (*self.cell_warnings, *training_warnings(self.training_returns))

    @property
    def skipped_files(self) -> tuple[str, ...]:
        """Sentences about requested files that could not be read."""
        roots = {id(results): results for results in (self.results, *self.other_roots.values())}.values()
        return tuple(dict.fromkeys(problem for results in roots for problem in results.problems))

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, and sentences about skipped files."""
        return (*self.warnings, *self.skipped_files)

    @functools.cached_property
    def training(self) -> pd.DataFrame:
        """Training windows of all runs, as stored."""
        return self._rows(Table.TRAINING, SCHEMAS[Table.TRAINING].names, self._run_ids)

    @functools.cached_property
    def training_returns(self) -> pd.DataFrame:
        """Training windows of all runs, with the columns `WINDOW_COLUMNS` only."""
        if "training" in vars(self):
            return self.training[WINDOW_COLUMNS]
        return self._rows(Table.TRAINING, WINDOW_COLUMNS, self._run_ids)

    @functools.cached_property
    def attempts(self) -> pd.DataFrame:
        """Attempts at all runs, as stored."""
        return self._rows(Table.ATTEMPTS, SCHEMAS[Table.ATTEMPTS].names, self._run_ids)

    @property
    def run_hours(self) -> pd.Series:
        """Wall-clock hours spent in all attempts at each run, by run id; empty if unknown."""
        attempts = self.attempts
        return attempts["wall_seconds"].astype(float).groupby(attempts["run_id"].astype(str)).sum() / 3600

    @property
    def _run_ids(self) -> list[str]:
        return list(self.cells["run_id"].unique())

    def with_core(self, campaigns: Sequence[str]) -> "Frames":
        """Return a copy with `campaigns` as the core, or with all campaigns if none are given."""
        core = self.cells["campaign"].isin(campaigns) if campaigns else True
        return replace(self, cells=self.cells.assign(core=core), core=tuple(campaigns))

    def results_of(self, run_id: str) -> Results:
        """Return the `Results` that hold the long tables of a run."""
        return self.other_roots.get(run_id, self.results)

    def episode_returns(self, run_ids: Sequence[str]) -> pd.DataFrame:
        """Return run_id, step and finite episodic_return of the training episodes of `run_ids`."""
        columns = ["run_id", "step", "episodic_return"]
        check_sequence("run_ids", run_ids)
        rows = self._rows(Table.EPISODES, columns, run_ids)
        return rows[np.isfinite(rows["episodic_return"].astype(float))]

    def episodes(self, run_id: str) -> pd.DataFrame:
        """Return the training episodes of one run, with tasks as float32 (d,)."""
        return self.of_runs(Table.EPISODES, [run_id])[run_id]

    def curriculum(self, run_id: str) -> pd.DataFrame:
        """Return the probed tasks of one run, as float32 (d,) each."""
        return self.of_runs(Table.CURRICULUM, [run_id])[run_id]

    def teacher_log(self, run_id: str) -> pd.DataFrame:
        """Return step, gaussians, boxes and scalars of every update of the teacher of one run."""
        return self.of_runs(Table.TEACHER_LOG, [run_id])[run_id]

    def of_runs(self, table: Table, run_ids: Sequence[str]) -> dict[str, pd.DataFrame]:
        """Read the rows of a long table in one pass, and return their columns `OF_ONE_RUN` by run id."""
        columns = OF_ONE_RUN[table]
        rows = self._rows(table, ["run_id", *columns], run_ids)
        indices, rows = positions(rows["run_id"]), rows[columns]
        empty = np.zeros(0, np.int64)
        return {run_id: rows.take(indices.get(run_id, empty)).reset_index(drop=True) for run_id in run_ids}

    def evaluations_of(self, run_ids: Collection[str]) -> pd.DataFrame:
        """Return the evaluations of the given runs, looked up in an index that is built only once."""
        indices = [self._positions[run_id] for run_id in run_ids if run_id in self._positions]
        return self.evaluations.take(np.concatenate([np.zeros(0, np.int64), *indices]))

    @functools.cached_property
    def _positions(self) -> dict[str, NDArray[np.int64]]:
        return positions(self.evaluations["run_id"])

    def _rows(self, table: Table, columns: list[str], run_ids: Sequence[str]) -> pd.DataFrame:
        """Read the rows of a long table for `run_ids`, which may lie in several roots."""
        all_ids = set(self._run_ids)
        for run_id in run_ids:
            check_type("run_id", run_id, str, "the id of one run")
            if run_id not in all_ids:
                check_known("run", run_id, self._run_ids[:SHOWN_RUNS], "the first ones are")
        roots: dict[int, tuple[Results, list[str]]] = {}
        for run_id in run_ids:
            results = self.results_of(run_id)
            roots.setdefault(id(results), (results, []))[1].append(run_id)
        parts = [read_table(results, table, columns, some_ids) for results, some_ids in roots.values()]
        if len(parts) == 1:
            return parts[0]
        return pd.concat(parts, ignore_index=True) if parts else read_table(self.results, table, columns, [])


def computed_once(
    function: Callable[Concatenate[Frames, P], pd.DataFrame],
) -> Callable[Concatenate[Frames, P], pd.DataFrame]:
    """Decorate a function of `Frames` to cache its result in the `Frames`, and to return copies of it."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def compute(frames: Frames, /, *args: P.args, **kwargs: P.kwargs) -> pd.DataFrame:
        check_type("frames", frames, Frames, "what analysis.load returns")
        bound = signature.bind(frames, *args, **kwargs)
        bound.apply_defaults()
        values = list(bound.arguments.values())[1:]
        key = (function, *(tuple(value) if isinstance(value, list) else value for value in values))
        if key not in frames._computed:
            frames._computed[key] = function(frames, *args, **kwargs)
        table: pd.DataFrame = frames._computed[key]
        return table.copy()

    return compute


def positions(run_ids: pd.Series) -> dict[str, NDArray[np.int64]]:
    """Return the ascending row numbers of each run by its id, given the column `run_ids` (n,)."""
    categories = run_ids.astype("category").cat
    order = np.argsort(categories.codes.to_numpy(), kind="stable")
    ends = np.cumsum(np.bincount(categories.codes, minlength=len(categories.categories)))
    return dict(zip(categories.categories, np.split(order, ends[:-1]), strict=True)) if len(ends) else {}


def unfailed(cells: pd.DataFrame) -> pd.DataFrame:
    """Return `GROUP`, `RUN_CONDITIONS`, seed, run_id and status of the cells whose runs did not fail."""
    return cells.loc[cells["status"] != "failed", [*GROUP, *RUN_CONDITIONS, "seed", "run_id", "status"]]


def read_table(
    results: Results, table: Table, columns: list[str] | None = None, run_ids: Sequence[str] | None = None
) -> pd.DataFrame:
    """Return a table with its strings as categoricals, since run ids repeat millions of times."""
    rows = results.table(table, run_ids=None if run_ids is None else set(run_ids), columns=columns)
    frame: pd.DataFrame = rows.to_pandas(strings_to_categorical=True)
    return frame


def check_columns(name: str, table: object, columns: Sequence[str]) -> None:
    """Check that the argument `name` is a table with the given columns.

    Raises:
        TypeError: if it is not a table, or `columns` is a single string.
        ValueError: if it lacks a column; the message names the nearest one.
    """
    check_type(name, table, pd.DataFrame, "a table, as from analysis.runs_after(frames)")
    check_sequence("columns", columns)
    assert isinstance(table, pd.DataFrame)
    for column in columns:
        check_known("column", column, table.columns, f"{name} has")


def check_measure(name: str, table: object, measure: str, columns: Sequence[str]) -> None:
    """Check that the argument `name` is a table with `columns` and a numeric `measure`.

    Raises:
        TypeError: as in `check_columns`.
        ValueError: if it lacks a column, or `measure` is not a column of numbers.
    """
    check_columns(name, table, [measure, *columns])
    assert isinstance(table, pd.DataFrame)
    values = table[measure].dropna()
    if len(values) and not pd.api.types.is_numeric_dtype(values.infer_objects()):
        raise ValueError(f"column {measure!r} is not a measure: {values.iloc[0]!r} is not a number")


def with_plain_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Convert strings and categoricals in a frame to Python strings, leaving missing values unchanged.

    Tables are grouped by a dozen short names again and again. pandas groups Arrow's strings several times
    more slowly than objects, and merging unequal categories is fragile.
    """
    types = pd.CategoricalDtype | pd.StringDtype  # by dtype, since pandas 2 cannot select by "str"
    return frame.astype({name: object for name, dtype in frame.dtypes.items() if isinstance(dtype, types)})


def training_warnings(training: pd.DataFrame) -> list[str]:
    """Return a warning about training windows whose mean return is NaN or infinite, if there are any."""
    windows = training[training["mean_return"].notna() & ~np.isfinite(training["mean_return"].astype(float))]
    nans = training[training["mean_return"].isna() & (training["episodes"] > 0)]
    if not len(windows) + len(nans):
        return []
    runs = pd.concat([windows["run_id"], nans["run_id"]]).astype(str)
    return [
        f"{counted(len(windows) + len(nans), 'window')} of training with a mean return that is NaN or "
        f"infinite: excluded ({named_runs(runs)})."
    ]


def named_runs(run_ids: pd.Series) -> str:
    """Format the number and the first ids of runs, such as ``2 runs: a, b``."""
    runs = sorted(set(run_ids))
    more = f" and {len(runs) - SHOWN_RUNS} more" if len(runs) > SHOWN_RUNS else ""
    return f"{counted(len(runs), 'run')}: {', '.join(runs[:SHOWN_RUNS])}{more}"


@contextmanager
def object_strings() -> Iterator[None]:
    """Context manager that makes pandas store strings as objects, which is a third faster than Arrow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            pd.get_option("future.infer_string")
        except KeyError:  # the option is gone in later versions of pandas
            yield
            return
        with pd.option_context("future.infer_string", False):
            yield
