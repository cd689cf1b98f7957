"""Writes imported seeds as the runs of a results root."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from tma_ray.importing.errors import ImportRefusedError
from tma_ray.importing.names import WITHOUT_KNOWLEDGE
from tma_ray.importing.rows import (
    PROBE_INTERVAL,
    curriculum_rows,
    episode_rows,
    evaluation_rows,
    training_rows,
)
from tma_ray.importing.seeds import ImportedSeed
from tma_ray.importing.teacher_history import DIMENSIONS
from tma_ray.importing.teacher_log import teacher_rows
from tma_ray.results.committer import Committer
from tma_ray.results.engines import BOX2D, BOX2D_TEST_SET, NO_PHYSICS_VERSION
from tma_ray.results.records import RunRecord
from tma_ray.results.schema import Table
from tma_ray.results.storage.store import Store
from tma_ray.results.writer import RunWriter
from tma_ray.tasks import MASTERY_RETURN

CAMPAIGN: Final = "original_release"
"""Name of the campaign that imported cells belong to."""

_TEST_SETS: Final = {
    "fish": "parkour_swimming",
    "climbing_chimpanzee": "parkour_climbing",
    "climbing_chest_chimpanzee": "parkour_climbing",
}
"""What bodies of Parkour that do not walk are tested on."""


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A seed as the run that it becomes, and pieces of its tables."""

    seed: ImportedSeed
    record: RunRecord
    pieces: tuple[tuple[Table, list[dict[str, Any]]], ...] = field(repr=False)


@dataclass
class ImportWriter:
    """Writes seeds as runs, each visible when it is whole, and in the end their cells.

    Attributes:
        store: an empty place, which becomes a results root with the first run.
        runs: name of the seed by id of its run.
        notes: what of a seed could not be imported, by its name.
    """

    store: Store
    runs: dict[str, str] = field(default_factory=dict)
    notes: dict[str, list[str]] = field(default_factory=dict)
    _cells: dict[tuple[str, ...], dict[str, Any]] = field(default_factory=dict)
    _tests: dict[str, str] = field(default_factory=dict)

    def prepare(self, seed: ImportedSeed) -> PreparedRun:
        """Returns the rows of a seed, without writing any.

        Raises:
            ValueError: something in the seed does not fit the tables.
        """
        record = self._record(seed)
        pieces = [(Table.EVALUATIONS, rows) for rows in evaluation_rows(seed, record.test_set)]
        pieces += [(Table.TRAINING, training_rows(seed)), (Table.EPISODES, episode_rows(seed))]
        pieces += [(Table.CURRICULUM, rows) for rows in curriculum_rows(seed)]
        pieces.append((Table.TEACHER_LOG, self._teacher_rows(seed)))
        return PreparedRun(seed, record, tuple(pieces))

    def write(self, run: PreparedRun) -> str:
        """Writes a run, unless it is there: the same files at another level are the same run.

        Returns:
            Name of the seed whose copy this is, empty if it is none.
        """
        seed, record = run.seed, run.record
        known = self.runs.get(record.run_id, "")
        self._add_cell(record, seed.folder.setting.level)
        if known:
            return known
        committer = Committer(self.store)
        attempt = committer.start(record)
        writer = RunWriter(self.store, record.run_id, attempt)
        for table, rows in run.pieces:
            writer.add(table, rows)
        if seed.problem:
            committer.publish(record, attempt, writer.flush())
            committer.fail(record, attempt, f"imported unfinished: {seed.problem}")
        else:
            committer.finish(record, attempt, writer.finish())
        self.runs[record.run_id] = seed.folder.name
        return ""

    def finish(self) -> None:
        """Writes the cells: those that were found, and what uses no knowledge at all levels of its others."""
        rows = list(self._cells.values())
        levels: dict[tuple[str, ...], set[str]] = {}
        for row in rows:
            levels.setdefault(_comparison(row), set()).add(row["expert_knowledge"])
        for row in rows:
            if row["teacher"] in WITHOUT_KNOWLEDGE:
                for level in levels[_comparison(row)]:
                    self._keep(row | {"expert_knowledge": level})
        Committer(self.store).write_cells(CAMPAIGN, list(self._cells.values()))

    def _add_cell(self, record: RunRecord, level: str) -> None:
        names = ("environment", "challenge", "embodiment", "student", "teacher", "seed", "run_id")
        experiment = record.challenge if record.environment == "stump_tracks" else "parkour"
        row = {name: getattr(record, name) for name in names}
        self._keep(row | {"expert_knowledge": level, "experiment": f"{BOX2D.lower()}_{experiment}"})

    def _keep(self, row: dict[str, Any]) -> None:
        key = tuple(str(row[name]) for name in ("run_id", "expert_knowledge"))
        self._cells[key] = row

    def _teacher_rows(self, seed: ImportedSeed) -> list[dict[str, Any]]:
        notes = self.notes.setdefault(seed.folder.name, [])
        if seed.history.samples is None:
            notes.append("its probes were left out: periodical_samples is not a list of tasks")
        if not len(seed.history.bounds):
            notes.append("its task space is unknown: env_param_bounds does not fit its tasks")
        try:
            return teacher_rows(seed)
        except ValueError as error:
            notes.append(f"its teacher's log was left out: {error}")
            return []

    def _record(self, seed: ImportedSeed) -> RunRecord:
        setting, digest = seed.folder.setting, seed.digest[:12]
        level = "none" if setting.teacher in WITHOUT_KNOWLEDGE else setting.level
        test_set = self._test_set(seed)
        spec = _spec(seed, level, test_set)
        return RunRecord(
            run_id=f"{BOX2D.lower()}-{seed.folder.student}-{setting.teacher}-s{seed.progress.seed}-{digest}",
            spec=json.dumps(spec, sort_keys=True),
            environment=setting.environment,
            challenge=setting.challenge,
            embodiment=setting.embodiment,
            student=seed.folder.student,
            teacher=setting.teacher,
            expert_knowledge=level,
            test_set=test_set,
            steps=seed.budget,
            seed=seed.progress.seed,
            physics_version=NO_PHYSICS_VERSION,
        )

    def _test_set(self, seed: ImportedSeed) -> str:
        """Returns the name of its test set; other tasks under a known name get another one."""
        setting = seed.folder.setting
        parkour = setting.environment == "parkour"
        plain = _TEST_SETS.get(setting.embodiment, "parkour_walking") if parkour else "stump_tracks"
        tasks = seed.history.test_tasks[: seed.tests].astype(np.float32)
        digest = hashlib.sha256(tasks.tobytes()).hexdigest()[:8]
        name = f"{BOX2D_TEST_SET}{plain}"
        return name if self._tests.setdefault(name, digest) == digest else f"{name}-{digest}"


def write_summary(store: Store, name: str, writer: ImportWriter, left_out: Mapping[str, str]) -> None:
    """Writes ``imported.json``: which folder of the source each run was, and what is missing.

    Args:
        store: the results root.
        name: of the source.
        writer: what wrote the runs.
        left_out: why seeds are not among them, by name.
    """
    notes = {seed: found for seed, found in writer.notes.items() if found}
    content = {
        "source": name,
        "engine": BOX2D,
        "runs": writer.runs,
        "notes": notes,
        "left_out": dict(left_out),
    }
    store.write_bytes("imported.json", (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())


def open_empty(root: str | Path) -> Store:
    """Returns the store of a place for an import.

    Raises:
        ImportRefusedError: something is there already.
        ResultsRootError: nothing is written to that place.
    """
    store = Store.open(root)
    store.check_access()
    there = store.entries()
    if there:
        raise ImportRefusedError(
            f"{store} is not empty ({there[0]}): results of another engine get a root of their own; "
            f"choose a new or empty folder"
        )
    return store


def _comparison(row: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(row[name]) for name in ("environment", "challenge", "embodiment", "student"))


def _spec(seed: ImportedSeed, level: str, test_set: str) -> dict[str, Any]:
    """Returns what is known of a run, as specs of ours have it, and the engine, which those have not."""
    setting, history = seed.folder.setting, seed.history
    names = DIMENSIONS[setting.environment]
    steps = seed.evaluated
    options = {"embodiment": setting.embodiment}
    if setting.original_embodiment:
        options["original_embodiment"] = setting.original_embodiment
    return {
        "engine": BOX2D,
        "environment": setting.environment,
        "environment_options": options,
        "challenge": setting.challenge,
        "task_space": [
            {"name": name, "low": low, "high": high, "unit": ""}
            for name, (low, high) in zip(names, history.bounds.tolist(), strict=False)
        ],
        "mastery_threshold": MASTERY_RETURN,
        "test_set": {
            "name": test_set,
            "dimensions": list(names),
            "tasks": history.test_tasks[: seed.tests].astype(np.float32).tolist(),
        },
        "student": seed.folder.student,
        "student_hyperparameters": dict(seed.progress.hyperparameters),
        "teacher": setting.teacher,
        "teacher_hyperparameters": {},
        "expert_knowledge": level,
        "schedule": {
            "steps": seed.budget,
            "evaluation_interval": min(np.diff([0, *steps]).tolist()) if len(steps) > 1 else seed.budget,
            "probe_interval": PROBE_INTERVAL,
        },
        "seed": seed.progress.seed,
        "repeat": "",
        "physics_version": NO_PHYSICS_VERSION,
        "plugins": {},
    }
