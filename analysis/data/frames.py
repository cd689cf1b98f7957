"""Result tables as pandas frames, ready to group by cell."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np
import pandas as pd

from analysis.data.evaluations import evaluation_measures, evaluation_warnings, training_warnings
from analysis.data.identity import CONDITIONS, experiments_apart, identity, named_apart
from tma_ray.commands.arguments import check_kind, check_known, check_names
from tma_ray.decoding import DamagedFileError, decode_json
from tma_ray.results import CHIPMUNK, SCHEMAS, Results, Table
from tma_ray.tasks import MASTERY_RETURN

COMPARISON = [
    *("engine", "experiment", "environment", "challenge", "embodiment", "student", "expert_knowledge")
]
"""Columns that teachers must have in common to be compared."""

GROUP = [*COMPARISON, "teacher"]
"""Columns that seeds must have in common to be averaged."""

SETTINGS = ["engine", "mastery_threshold", "settings", "identity"]
"""Columns of cells that come from the spec; settings is a short hash of all of it but the seed, identity the
JSON of `identity.identity`."""

SEED = re.compile(r'"seed": \d+, "student":')
"""The seed in a spec, whose keys are sorted, with the key that follows it."""

P = ParamSpec("P")

SHOWN_RUNS = 3
"""Runs that a message about an unknown one names."""

STATUSES = ("done", "running", "failed", "waiting")
"""What a run of a cell may be; waiting is a cell whose run has not started."""


@dataclass(frozen=True)
class Frames:
    """The results of one root. Tables that not all need, and those that hold tasks, are read when asked for.

    Attributes:
        cells: one row per cell and run: `GROUP`, campaign, seed, run_id, status, error, spec, steps,
            test_set, physics_version, and of the spec `SETTINGS`: engine (what simulated the worlds),
            mastery_threshold, settings and identity. Names that would stand for several things are split:
            see `identity.named_apart`.
        evaluations: run_id, step, test_set, task_index, episodic_return, and mastered: whether that
            is over the threshold of its run.
        measured: one row per run and evaluation, of `evaluations.evaluation_measures`: computed once.
        test_tasks: test_set, task_index, task (float32 (d,)).
        told: what a reader must know of cells and evaluations before trusting a comparison.
        results: where the long tables are read from.
        elsewhere: where those of a run are read from that other results hold, of several joined roots.
    """

    cells: pd.DataFrame
    evaluations: pd.DataFrame
    measured: pd.DataFrame
    test_tasks: pd.DataFrame
    results: Results = field(repr=False)
    told: tuple[str, ...] = ()
    elsewhere: Mapping[str, Results] = field(default_factory=dict, repr=False)
    _computed: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def warnings(self) -> tuple[str, ...]:
        """All that a reader must know before trusting a comparison, of training too."""
        return (*self.told, *training_warnings(self.training))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sentences on files that could not be read, of those that have been asked for."""
        places = {id(each): each for each in (self.results, *self.elsewhere.values())}.values()
        return tuple(dict.fromkeys(text for each in places for text in each.problems))

    @property
    def notes(self) -> tuple[str, ...]:
        """All that a reader must know: the warnings, and which files were left out."""
        return (*self.warnings, *self.left_out)

    @functools.cached_property
    def training(self) -> pd.DataFrame:
        """Windows of training of all runs, as stored."""
        return self._rows(Table.TRAINING, list(SCHEMAS[Table.TRAINING].names), self._run_ids)

    @functools.cached_property
    def attempts(self) -> pd.DataFrame:
        """Attempts at all runs, as stored."""
        return self._rows(Table.ATTEMPTS, list(SCHEMAS[Table.ATTEMPTS].names), self._run_ids)

    @property
    def _run_ids(self) -> list[str]:
        return list(self.cells["run_id"].unique())

    def results_of(self, run_id: str) -> Results:
        """Returns the results that hold a run."""
        return self.elsewhere.get(run_id, self.results)

    def episode_returns(self, run_ids: Sequence[str]) -> pd.DataFrame:
        """Returns run_id, step and finite episodic_return of the training episodes of `run_ids`."""
        columns = ["run_id", "step", "episodic_return"]
        check_names("run_ids", run_ids)
        rows = self._rows(Table.EPISODES, columns, run_ids)
        return rows[np.isfinite(rows["episodic_return"].astype(float))]

    def episodes(self, run_id: str) -> pd.DataFrame:
        """Returns the training episodes of one run, tasks as float32 (d,)."""
        columns = ["step", "episode", "task", "world_task", "episodic_return"]
        return self._rows(Table.EPISODES, columns, [run_id])

    def curriculum(self, run_id: str) -> pd.DataFrame:
        """Returns the probed tasks of one run, tasks as float32 (d,)."""
        return self._rows(Table.CURRICULUM, ["step", "sample", "task"], [run_id])

    def teacher_log(self, run_id: str) -> pd.DataFrame:
        """Returns step, gaussians, boxes and scalars of every update of the teacher of one run."""
        return self._rows(Table.TEACHER_LOG, ["step", "gaussians", "boxes", "scalars"], [run_id])

    def _rows(self, table: Table, columns: list[str], run_ids: Sequence[str]) -> pd.DataFrame:
        """Reads a long table of some runs, from wherever they are."""
        known = set(self._run_ids)
        for run_id in run_ids:
            check_kind("run_id", run_id, str, "the id of one run")
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
    """Returns `function` made to compute each frame once for the same `Frames`; every caller has a copy."""

    @functools.wraps(function)
    def compute(frames: Frames, /, *args: P.args, **kwargs: P.kwargs) -> pd.DataFrame:
        check_kind("frames", frames, Frames, "what analysis.load returns")
        given = (*args, *kwargs.values())
        key = (
            function,
            tuple(kwargs),
            tuple(tuple(each) if isinstance(each, list) else each for each in given),
        )
        if key not in frames._computed:
            frames._computed[key] = function(frames, *args, **kwargs)
        found: pd.DataFrame = frames._computed[key]
        return found.copy()

    return compute


def load(root: str | Path) -> Frames:
    """Reads a root, finished or not; what is missing becomes an empty frame and a warning.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: no results root at that place.
    """
    results = Results.open(root)
    runs = _with_settings(_plain(results.table(Table.RUNS).to_pandas()))
    (cells,), split = named_apart([_join(_plain(_frame(results, Table.CELLS)), runs)])
    cells, apart = experiments_apart(cells)
    columns = ["run_id", "step", "test_set", "task_index", "episodic_return"]
    evaluations = _frame(results, Table.EVALUATIONS, columns)
    evaluations["mastered"] = evaluations["episodic_return"] > _thresholds(evaluations, runs)
    measured = evaluation_measures(evaluations)
    told = *cell_warnings(cells, evaluations), *evaluation_warnings(measured)
    return Frames(
        cells=cells,
        evaluations=evaluations,
        measured=measured,
        test_tasks=_test_tasks(results, evaluations),
        results=results,
        told=(*told, *split, *apart),
    )


def unfailed(cells: pd.DataFrame) -> pd.DataFrame:
    """Returns `GROUP`, `CONDITIONS`, seed, run_id and status of the cells whose runs did not fail."""
    return cells.loc[cells["status"] != "failed", [*GROUP, *CONDITIONS, "seed", "run_id", "status"]]


def parsed(text: object) -> dict[str, Any]:
    """Returns the JSON object in `text`, or an empty one if it holds something else."""
    try:
        return decode_json(text, dict[str, Any], "a spec") if isinstance(text, str) else {}
    except DamagedFileError:
        return {}


def mastery_threshold(spec: object) -> float:
    """Returns the episodic return over which tasks are mastered in a run with this `spec` (JSON)."""
    return float(parsed(spec).get("mastery_threshold", MASTERY_RETURN))


def _frame(
    results: Results, table: Table, columns: list[str] | None = None, run_ids: Sequence[str] | None = None
) -> pd.DataFrame:
    """Reads a table with its strings as categories: run ids repeat millions of times."""
    content = results.table(table, run_ids=None if run_ids is None else set(run_ids), columns=columns)
    frame: pd.DataFrame = content.to_pandas(strings_to_categorical=True)
    return frame


def _with_settings(runs: pd.DataFrame) -> pd.DataFrame:
    """Adds what comparisons need of each run's spec: engine, mastery_threshold, settings and identity.

    A spec is long, and there are thousands: those that differ in their seed alone are parsed once.
    """
    texts = [_without_seed(spec) for spec in runs["spec"]]
    known = {text: _settings(text) for text in set(texts)}
    return runs.assign(**{name: [known[text][name] for text in texts] for name in SETTINGS})


def _thresholds(evaluations: pd.DataFrame, runs: pd.DataFrame) -> pd.Series | float:
    """Returns the threshold of each evaluation's run; one number where all have the same."""
    known = runs["mastery_threshold"].unique()
    if len(known) == 1:
        return float(known[0])
    return evaluations["run_id"].map(runs.set_index("run_id")["mastery_threshold"]).astype(float)


def _without_seed(spec: str) -> str:
    text, found = SEED.subn('"student":', spec, count=1)
    content = {} if found else parsed(spec)
    return text if found else json.dumps({name: content[name] for name in content if name != "seed"})


def _settings(text: str) -> dict[str, Any]:
    spec = parsed(text)
    return {
        "engine": str(spec.get("engine", CHIPMUNK)),
        "mastery_threshold": float(spec.get("mastery_threshold", MASTERY_RETURN)),
        "settings": hashlib.sha256(text.encode()).hexdigest()[:12],
        "identity": json.dumps(identity(spec), sort_keys=True),
    }


def _join(cells: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Joins cells with the state of their runs; runs outside any campaign are cells of their own."""
    alone = runs[~runs["run_id"].isin(cells["run_id"])]
    single = alone.reindex(columns=cells.columns).assign(campaign="", experiment="single runs")
    cells = pd.concat([cells, single], ignore_index=True) if len(single) else cells
    names = ("run_id", "status", "error", "spec", "steps", "test_set", "physics_version")
    state = runs[[*names, *SETTINGS]]
    joined = cells.merge(state, on="run_id", how="left")
    joined["engine"] = joined["engine"].fillna(CHIPMUNK)  # only campaigns of ours have runs that wait
    joined["status"] = joined["status"].fillna("waiting")
    joined["error"] = joined["error"].fillna("")
    # Two campaigns on one root may list the same cell: its runs count once.
    return joined.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def _plain(frame: pd.DataFrame) -> pd.DataFrame:
    """Turns categories back into strings: few rows, and merging unequal categories is fragile."""
    categories = frame.select_dtypes("category").columns
    return frame.astype(dict.fromkeys(categories, object))


def _test_tasks(results: Results, evaluations: pd.DataFrame) -> pd.DataFrame:
    """Reads the tasks of each test set from one run that met it: they are the same in all."""
    columns = ["test_set", "task_index", "task"]
    witnesses = evaluations.drop_duplicates("test_set")["run_id"].astype(str).tolist()
    tasks = _plain(_frame(results, Table.EVALUATIONS, columns, witnesses))
    return tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True)


def cell_warnings(cells: pd.DataFrame, evaluations: pd.DataFrame) -> list[str]:
    """Returns sentences on missing results, and on engines that stand apart."""
    found = []
    if cells.empty:
        found.append("This root holds no runs yet.")
    elif evaluations.empty:
        found.append("No evaluation has finished yet, so there is nothing to compare.")
    engines = sorted(cells["engine"].unique())
    if len(engines) > 1:
        found.append(f"Runs of different engines ({', '.join(engines)}) stand apart and are never compared.")
    return found
