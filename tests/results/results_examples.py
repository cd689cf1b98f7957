"""Rows and runs for the tests of the results package."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.results import Committer, PartFile, RunRecord, RunWriter, Store, Table
from tma_ray.results.storage import BucketStore
from tma_ray.runs.run import teacher_log_row
from tma_ray.tasks import ScoredBox, TeacherUpdate, WeightedGaussian

TASKS_PER_EVALUATION = 5

OLD_ROOT = Path(__file__).parents[1] / "compatibility" / "version_1" / "root"
"""Results of the first version of the schema."""


def make_record(run_id: str) -> RunRecord:
    names = ("{}", "stump_tracks", "original", "bipedal", "sac", "alp_gmm", "none", "grid")
    return RunRecord(run_id, *names, steps=1000, seed=0, physics_version=1)


def make_rows(rng: np.random.Generator, step: int) -> list[tuple[Table, list[dict[str, Any]]]]:
    """Return rows of all data tables, including one evaluation."""
    task = rng.random(2).astype(np.float32)
    update = TeacherUpdate(
        gaussians=tuple(WeightedGaussian(0.5, rng.random(2), np.eye(2)) for _ in range(step % 3)),
        boxes=(ScoredBox(np.zeros(2), rng.random(2), 0.1),),
        scalars={"progress": float(rng.random()), "noise": 0.0},
    )
    evaluation = [
        {"step": step, "test_set": "grid" if index % 2 else "extra", "task_index": index, "task": task}
        | {"episodic_return": float(rng.normal()), "length": int(rng.integers(2000))}
        for index in range(TASKS_PER_EVALUATION)
    ]
    return [
        (Table.EVALUATIONS, evaluation),
        (Table.TRAINING, [_training_row(rng, step)]),
        (Table.EPISODES, [_episode_row(rng, step + i, shuffled=i == 1) for i in range(3)]),
        (Table.CURRICULUM, [{"step": step, "sample": i, "task": task} for i in range(2)]),
        (Table.TEACHER_LOG, [teacher_log_row(step, step // 10, update)]),
    ]


def add_run(
    store: Store,
    run_id: str = "run-1",
    steps: Sequence[int] = (0,),
    *,
    finished: bool = True,
    empty: Table | None = None,
) -> list[PartFile]:
    """Write a run with published parts at every step, optionally with one table empty; return the parts."""
    committer, record = Committer(store), make_record(run_id)
    writer = RunWriter(store, run_id, committer.start(record))
    for step in steps:
        for table, rows in make_rows(np.random.default_rng([step, *run_id.encode()]), step):
            if table is not empty:
                writer.add(table, rows)
        parts = writer.flush()
    committer.publish(record, writer.attempt, parts)
    if finished:
        committer.finish(record, writer.attempt, writer.finish())
    return list(parts)


def make_cell(run_id: str, seed: int = 0, experiment: str = "x", teacher: str = "alp_gmm") -> dict[str, Any]:
    names = ("environment", "challenge", "embodiment", "student", "expert_knowledge")
    names_of = dict.fromkeys(names, "x") | {"experiment": experiment, "teacher": teacher}
    return names_of | {"seed": seed, "run_id": run_id}


def _training_row(rng: np.random.Generator, step: int) -> dict[str, Any]:
    values = dict.fromkeys(("mean_return", "std_return", "mean_length", "success_share"), float(rng.random()))
    return {"step": step, "episodes": 3, **values}


def _episode_row(rng: np.random.Generator, step: int, *, shuffled: bool) -> dict[str, Any]:
    task = rng.random(2).astype(np.float32)
    world_task = rng.random(2).astype(np.float32) if shuffled else None
    row = {"step": step, "episode": step, "task": task, "world_task": world_task, "length": 7}
    return row | {"episodic_return": float(rng.normal()), "success": bool(rng.random() > 0.5)}


def sibling(store: Store, suffix: str) -> Store:
    """Return a store next to another one, with `suffix` appended to its name."""
    if isinstance(store, BucketStore):
        return BucketStore(store._objects, f"{store}{suffix}")
    return type(store).at(f"{store}{suffix}")


def tree(store: Store, *, keep: Callable[[str], bool] = lambda path: True) -> dict[str, bytes]:
    """Return the content of all files except temporary ones, by path."""
    paths = [path for path in store.files() if not path.startswith("tmp/") and keep(path)]
    return {path: store.read_bytes(path) for path in paths}
