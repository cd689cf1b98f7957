"""Small real runs for the fast suite; as a script, finishes runs in a new process.

python small_runs.py FOLDER ...   # each with a spec.json; its results root is FOLDER/resumed
"""

import json
import sys
from collections.abc import Callable
from itertools import count
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.envs import Environment
from tma_ray.results import Committer, Results, RunWriter, Store, Table
from tma_ray.runs import Cell, InlineTeacher, Placement, RunSpec, Schedule, effective_spec, run_locally
from tma_ray.runs.run import Run
from tma_ray.tasks import KnowledgeLevel, Task

SCHEDULE = Schedule(3_000, 1_000, probe_interval=500, probe_size=10, training_window=1_000)

STUDENTS: dict[str, dict[str, Any]] = {
    "ppo": {"hidden_units": [32, 32], "steps_per_update": 400, "batch_size": 100},
    "sac": {"hidden_units": [32, 32], "exploration_steps": 500, "batch_size": 64, "buffer_size": 2_000},
}

TEACHERS: dict[str, dict[str, Any]] = {
    "random": {},
    **{name: {"buffer_size": 10} for name in ("accel", "plr", "robust_plr", "traced")},
    **{name: {"fit_every": 20} for name in ("alp_gmm", "covar_gmm")},
    **{name: {"first_update": 500, "update_every": 250} for name in ("spdl", "spgl")},
    "adr": {"queue_size": 3},
    "currot": {"particles": 20, "update_every": 10},
    "doraemon": {"update_every": 200},
    "riac": {"region_capacity": 20, "split_attempts": 5},
    "sfl": {"candidates": 3, "rollouts": 2, "refresh_every": 15},
    "lp_acrl": {"cells": 4, "stage_episodes": 15},
    "perm": {"window_episodes": 15, "bumps": 5},
    "procurl_target": {"first_update": 200, "update_every": 200, "pool_size": 30},
    "goal_gan": {"train_every": 20, "iterations_per_task": 0.2, "pretraining_iterations": 10},
    "setter_solver": {"update_every": 20, "hidden_units": 8},
}


def small_spec(
    folder: Path, student: str = "ppo", teacher: str = "random", seed: int = 0, **changes: Any
) -> RunSpec:
    """Return the spec of a run of about 150 short episodes, with small networks and three test tasks."""
    tests = folder / "three.csv"
    tests.write_text("distance,wind\n1,0\n4,0.5\n8,0.2\n")
    schedule = Schedule(**{**vars(SCHEDULE), **changes})
    return effective_spec(_cell("corridor:Corridor", "", student, teacher, tests), seed, schedule)


def stump_tracks_spec(folder: Path, student: str, teacher: str, **changes: Any) -> RunSpec:
    """Return the spec of a run of a few episodes on Stump Tracks, with small networks and three tests."""
    tests = folder / "three.csv"
    tests.write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n3,1\n")
    cell = _cell("stump_tracks", "classic_bipedal", student, teacher, tests)
    longer = {"steps": 6_000, "evaluation_interval": 3_000}
    return effective_spec(cell, 0, Schedule(**{**vars(SCHEDULE), **longer, **changes}))


def _cell(environment: str, embodiment: str, student: str, teacher: str, tests: Path) -> Cell:
    settings = {"teacher_hyperparameters": TEACHERS.get(teacher, {}), "test_set": str(tests)}
    settings["student_hyperparameters"] = STUDENTS[student]
    return Cell(environment, "original", embodiment, student, teacher, KnowledgeLevel.LOW, **settings)


def data_files(root: str | Path) -> dict[str, bytes]:
    """Return the canonical data files of all runs of a root, by path."""
    store = Store.open(root)
    about = ("tables/runs/", "tables/attempts/", "tables/cells/")
    return {path: store.read_bytes(path) for path in store.files("tables") if not path.startswith(about)}


def short_run(folder: Path) -> tuple[RunSpec, dict[str, bytes]]:
    """Return the spec of a short run, and its data files after an undisturbed execution."""
    spec = small_spec(folder, teacher="alp_gmm", steps=1_000)
    run(spec, folder / "undisturbed")
    return spec, data_files(folder / "undisturbed")


def run(
    spec: RunSpec, root: str | Path, stop_after: int | None = None, placement: Placement | None = None
) -> str:
    """Execute a run, stopping after `stop_after` episodes; return the outcome."""
    episodes, last = count(1), inf if stop_after is None else stop_after
    return run_locally(spec, Committer.open(root), placement, lambda: next(episodes) >= last).value


def new_run(spec: RunSpec, root: Path, attempt: int = 0, teacher: type[InlineTeacher] = InlineTeacher) -> Run:
    """Return a new run that writes its rows to `root`."""
    return Run(spec, teacher(spec), RunWriter(Store.open(root), spec.run_id, attempt))


def one_episode(
    environment: Environment, act_greedily: Callable[[np.ndarray], np.ndarray], task: Task, seed: int
) -> tuple[int, float]:
    """Play an episode greedily; return its length and return."""
    observation, _ = environment.reset(seed=seed, options={"task": task})
    total, length, over = 0.0, 0, False
    while not over:
        action = act_greedily(observation[None])[0]
        observation, reward, terminated, truncated, _ = environment.step(action)
        total, length, over = total + float(reward), length + 1, terminated or truncated
    return length, total


def rows(root: str | Path, table: Table) -> list[dict[str, Any]]:
    return Results.open(root).table(table).to_pylist()


def finish(folders: list[Path]) -> None:
    """Finish runs, and check that torch's compiler, which is slow to import, was not imported."""
    for folder in folders:
        run(RunSpec.from_dict(json.loads((folder / "spec.json").read_text())), folder / "resumed")
    assert "torch._dynamo" not in sys.modules


if __name__ == "__main__":
    finish([Path(folder) for folder in sys.argv[1:]])
