"""Rows and runs for the tests of the results package."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.results import RunRecord, Store, Table, teacher_log_row
from tma_ray.results.storage import BucketStore
from tma_ray.tasks import ScoredBox, TeacherUpdate, WeightedGaussian

TASKS_PER_EVALUATION = 5

OLD_ROOT = Path(__file__).parents[1] / "compatibility" / "version_1" / "root"
"""Results of the first version of the schema."""


def make_record(run_id: str) -> RunRecord:
    names = ("{}", "stump_tracks", "original", "bipedal", "sac", "alp_gmm", "none", "grid")
    return RunRecord(run_id, *names, steps=1000, seed=0, physics_version=1)


def make_rows(rng: np.random.Generator, step: int) -> list[tuple[Table, list[dict[str, Any]]]]:
    """Rows of all data tables, one evaluation among them."""
    task = rng.random(2).astype(np.float32)
    update = TeacherUpdate(
        gaussians=tuple(WeightedGaussian(0.5, rng.random(2), np.eye(2)) for _ in range(step % 3)),
        boxes=(ScoredBox(np.zeros(2), rng.random(2), 0.1),),
        scalars={"progress": float(rng.random()), "noise": 0.0},
    )
    evaluation = [
        {
            "step": step,
            "test_set": "grid" if index % 2 else "extra",
            "task_index": index,
            "task": task,
            "episodic_return": float(rng.normal()),
            "length": int(rng.integers(2000)),
        }
        for index in range(TASKS_PER_EVALUATION)
    ]
    return [
        (Table.EVALUATIONS, evaluation),
        (Table.TRAINING, [_training_row(rng, step)]),
        (Table.EPISODES, [_episode_row(rng, step + i, shuffled=i == 1) for i in range(3)]),
        (Table.CURRICULUM, [{"step": step, "sample": i, "task": task} for i in range(2)]),
        (Table.TEACHER_LOG, [teacher_log_row(step, step // 10, update)]),
    ]


def _training_row(rng: np.random.Generator, step: int) -> dict[str, Any]:
    values = dict.fromkeys(("mean_return", "std_return", "mean_length", "success_share"), float(rng.random()))
    return {"step": step, "episodes": 3, **values}


def _episode_row(rng: np.random.Generator, step: int, *, shuffled: bool) -> dict[str, Any]:
    return {
        "step": step,
        "episode": step,
        "task": rng.random(2).astype(np.float32),
        "world_task": rng.random(2).astype(np.float32) if shuffled else None,
        "episodic_return": float(rng.normal()),
        "length": 7,
        "success": bool(rng.random() > 0.5),
    }


def sibling(store: Store, suffix: str) -> Store:
    """A store whose root lies next to that of another, with `suffix` after its name."""
    if isinstance(store, BucketStore):
        return BucketStore(store._objects, f"{store}{suffix}")
    return type(store).at(f"{store}{suffix}")


def tree(store: Store, *, keep: Callable[[str], bool] = lambda path: True) -> dict[str, bytes]:
    """Content of all files but those in the making."""
    paths = [path for path in store.files() if not path.startswith("tmp/") and keep(path)]
    return {path: store.read_bytes(path) for path in paths}
