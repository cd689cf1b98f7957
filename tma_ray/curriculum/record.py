"""The record of a curriculum as a results root, for figures and reports."""

import json
import re
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple, Protocol

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.results import NO_PHYSICS_VERSION, Committer, RunRecord, RunWriter, Table, spec_digest
from tma_ray.support.component_names import base_name
from tma_ray.tasks import Episode, Task, TaskSpace
from tma_ray.teachers import Teacher, hyperparameters_of

EXTERNAL = "external"
"""Environment, embodiment, student and test set of a run in somebody else's training loop, and its engine."""

PROBE_SIZE = 100  # tasks of the probe at the end


class EpisodeRow(NamedTuple):
    """A reported episode; fields as of `Episode`."""

    step: int
    task: Task
    episodic_return: float
    length: int
    success: bool
    trains: bool

    @classmethod
    def of(cls, episode: Episode) -> "EpisodeRow":
        """Return the row of an episode."""
        return cls(*(getattr(episode, name) for name in cls._fields))


class Recorded(Protocol):
    """What a record is made of; see `Curriculum`."""

    space: TaskSpace
    mastery_return: float
    seed: int
    steps: int
    _name: str
    _teacher: Teacher
    _rows: list[EpisodeRow]
    _log: list[dict[str, object]]

    def probe(self, count: int) -> Task:
        """Return tasks (count, d) without exploration."""


def write_record(folder: Path, curriculum: Recorded, state_file: str, state: bytes) -> None:
    """Write the record and the state of a curriculum; replace one that was saved in `folder` before.

    Raises:
        FileExistsError: the folder has something else.
    """
    if folder.exists() and any(folder.iterdir()) and not (folder / state_file).is_file():
        raise FileExistsError(f"{folder} has something else than a saved curriculum: choose a new folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
        new, old = Path(temporary) / "new", Path(temporary) / "old"
        _write_root(new, curriculum)
        (new / state_file).write_bytes(state)
        if folder.exists():
            folder.rename(old)
        new.rename(folder)
        shutil.rmtree(old, ignore_errors=True)


def _write_root(root: Path, curriculum: Recorded) -> None:
    record, committer = _run_record(curriculum), Committer.open(root)
    names = (
        "environment",
        "challenge",
        "embodiment",
        "student",
        "teacher",
        "expert_knowledge",
        "seed",
        "run_id",
    )
    cell = {name: getattr(record, name) for name in names}
    committer.write_cells(EXTERNAL, [{"experiment": EXTERNAL, **cell}])
    attempt = committer.start(record)
    writer = RunWriter(committer.store, record.run_id, attempt)
    rows = [
        {"episode": index, "world_task": None, **row._asdict()} for index, row in enumerate(curriculum._rows)
    ]
    writer.add(Table.EPISODES, rows)
    probe = enumerate(curriculum.probe(PROBE_SIZE))
    writer.add(
        Table.CURRICULUM,
        [{"step": curriculum.steps, "sample": index, "task": task} for index, task in probe],
    )
    writer.add(Table.TEACHER_LOG, curriculum._log)
    committer.finish(record, attempt, writer.finish())


def _run_record(curriculum: Recorded) -> RunRecord:
    """Return the run with what determines the curriculum, under the names of a `RunSpec`."""
    level = curriculum._teacher.knowledge.level.value
    spec = {
        "engine": EXTERNAL,
        "environment": EXTERNAL,
        "environment_options": {"embodiment": EXTERNAL},
        "challenge": EXTERNAL,
        "task_space": [asdict(dimension) for dimension in curriculum.space.dimensions],
        "mastery_threshold": curriculum.mastery_return,
        "test_set": {"name": EXTERNAL, "dimensions": list(curriculum.space.names)},
        "student": EXTERNAL,
        "student_hyperparameters": {},
        "teacher": curriculum._name,
        "teacher_hyperparameters": hyperparameters_of(curriculum._teacher),
        "expert_knowledge": level,
        "schedule": {"steps": curriculum.steps},
        "seed": curriculum.seed,
        "physics_version": NO_PHYSICS_VERSION,
    }
    text = json.dumps(spec, sort_keys=True)
    readable = re.sub(r"[^0-9a-zA-Z]+", "_", base_name(curriculum._name)).strip("_")
    return RunRecord(
        run_id=f"{EXTERNAL}-{readable}-s{curriculum.seed}-{spec_digest(text)[:12]}",
        spec=text,
        environment=EXTERNAL,
        challenge=EXTERNAL,
        embodiment=EXTERNAL,
        student=EXTERNAL,
        teacher=curriculum._name,
        expert_knowledge=level,
        test_set=EXTERNAL,
        steps=curriculum.steps,
        seed=curriculum.seed,
        physics_version=NO_PHYSICS_VERSION,
        benchmark_version=BENCHMARK_VERSION,
    )
