"""Episodes of a student that is simulated by a formula, to train teachers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tma_ray.tasks import Answer, Episode, KnowledgeLevel, Query, QueryKind, Task, TaskSpace, expert_knowledge
from tma_ray.teachers import Teacher, make_teacher

SPACES = {
    "stump_tracks": TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)}),
    "line": TaskSpace.from_bounds({"x": (-1, 1)}),
    "with_constants": TaskSpace.from_bounds({"a": (0, 1), "fixed": (10, 10), "b": (-5, 5)}),
    "twenty": TaskSpace.from_bounds({f"x{i}": (0, i + 1) for i in range(20)}),
}

QUICK: dict[str, dict[str, Any]] = {
    "spdl": {"first_update": 10_000, "update_every": 5_000},
    "goal_gan": {"iterations_per_task": 0.1, "pretraining_iterations": 10},
    "setter_solver": {"hidden_units": 8},
}
"""Hyper-parameters for quick tests of a few hundred episodes of `EPISODE_LENGTH` steps."""

EPISODE_LENGTH = 100


def started(
    name: str,
    space: TaskSpace,
    seed: int = 0,
    level: KnowledgeLevel = KnowledgeLevel.HIGH,
    easy_task: Sequence[float] | None = None,
    **hyperparameters: Any,
) -> Any:
    """Return a started teacher; the easy task is the lower corner of the space by default."""
    teacher = make_teacher(name, QUICK.get(name, {}) | hyperparameters)
    easy = space.low if easy_task is None else easy_task
    knowledge = expert_knowledge(level, space, np.random.default_rng(seed), easy)
    teacher.start(space, knowledge, np.random.default_rng(seed))
    return teacher


def ended(task: Any, episodic_return: float = 0.0, success: bool = False, step: int = 0) -> Episode:
    """Return an episode of ten steps with a given task, return and success."""
    task = np.asarray(task, np.float32)
    return Episode(task, episodic_return, success, 10, np.zeros(1, np.float32), 0.0, step)


def play(teacher: Teacher, episodes: int, step: int = 0) -> list[Task]:
    """Play episodes of an improving student, best at the lower corner of the space, after `step` others."""
    tasks = []
    for index in range(step, step + episodes):
        task = teacher.propose().task
        difficulty = float(teacher.space.normalise(task).mean())
        gained, end = 300 - 400 * difficulty + 0.2 * index, EPISODE_LENGTH * (index + 1)
        first = np.array([difficulty, 0, 0], dtype=np.float32)
        query = teacher.observe(Episode(task, gained, gained > 230, EPISODE_LENGTH, first, gained / 5, end))
        while query is not None:
            query = teacher.answer(answer(query))
        tasks.append(task)
    return tasks


def answer(query: Query) -> Answer:
    assert query.kind is QueryKind.STATE_VALUES
    return 60 - 80 * query.observations[:, 0].astype(np.float64)
