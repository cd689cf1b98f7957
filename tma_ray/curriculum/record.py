"""Record of a curriculum, stored as a results root for figures and reports."""

import json
import re
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.results import NO_PHYSICS_VERSION, Committer, RunRecord, RunWriter, Table, spec_digest
from tma_ray.support.component_names import base_name
from tma_ray.tasks import Episode, Task, TaskSpace
from tma_ray.teachers import Teacher, hyperparameters_of

EXTERNAL = "external"  # name of environment, body, student, test set and engine in a record
PROBE_SIZE = 100  # number of tasks in the final probe


class EpisodeRow(NamedTuple):
    """Reported episode, with the fields of `Episode`."""

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
    """Attributes of a `Curriculum` that are recorded."""

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
    """Write the record and the state of a curriculum to `folder`, replacing earlier ones.

    Raises:
        FileExistsError: if the folder has other contents.
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
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge", "seed")
    cell = {name: getattr(record, name) for name in (*names, "run_id")}
    committer.write_cells(EXTERNAL, [{"experiment": EXTERNAL, **cell}])
    attempt = committer.start(record)
    writer = RunWriter(committer.store, record.run_id, attempt)
    rows = [
        {"episode": index, "world_task": None, **row._asdict()} for index, row in enumerate(curriculum._rows)
    ]
    writer.add(Table.EPISODES, rows)
    tasks = enumerate(curriculum.probe(PROBE_SIZE))
    rows = [{"step": curriculum.steps, "sample": index, "task": task} for index, task in tasks]
    writer.add(Table.CURRICULUM, rows)
    writer.add(Table.TEACHER_LOG, curriculum._log)
    committer.finish(record, attempt, writer.finish())


def _run_record(curriculum: Recorded) -> RunRecord:
    """Return the run record of a curriculum, with a spec that has the fields of a `RunSpec`."""
    common: dict[str, Any] = {
        "environment": EXTERNAL,
        "challenge": EXTERNAL,
        "student": EXTERNAL,
        "teacher": curriculum._name,
        "expert_knowledge": curriculum._teacher.knowledge.level.value,
        "seed": curriculum.seed,
        "physics_version": NO_PHYSICS_VERSION,
    }
    spec = common | {
        "engine": EXTERNAL,
        "environment_options": {"embodiment": EXTERNAL},
        "task_space": [asdict(dimension) for dimension in curriculum.space.dimensions],
        "mastery_threshold": curriculum.mastery_return,
        "test_set": {"name": EXTERNAL, "dimensions": list(curriculum.space.names)},
        "student_hyperparameters": {},
        "teacher_hyperparameters": hyperparameters_of(curriculum._teacher),
        "schedule": {"steps": curriculum.steps},
    }
    text = json.dumps(spec, sort_keys=True)
    readable = re.sub(r"[^0-9a-zA-Z]+", "_", base_name(curriculum._name)).strip("_")
    return RunRecord(
        run_id=f"{EXTERNAL}-{readable}-s{curriculum.seed}-{spec_digest(text)[:12]}",
        spec=text,
        embodiment=EXTERNAL,
        test_set=EXTERNAL,
        steps=curriculum.steps,
        benchmark_version=BENCHMARK_VERSION,
        **common,
    )
