"""A student simulated by a formula: enough to make a teacher learn."""

from __future__ import annotations

import numpy as np

from tma_ray.tasks import Episode, KnowledgeLevel, Task, TaskSpace, expert_knowledge
from tma_ray.teachers import Teacher, make_teacher

SPACES = {
    "stump_tracks": TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)}),
    "line": TaskSpace.from_bounds({"x": (-1, 1)}),
    "with_constants": TaskSpace.from_bounds({"a": (0, 1), "fixed": (10, 10), "b": (-5, 5)}),
    "twenty": TaskSpace.from_bounds({f"x{i}": (0, i + 1) for i in range(20)}),
}


def started(
    name: str, space: TaskSpace, seed: int = 0, level: KnowledgeLevel = KnowledgeLevel.HIGH
) -> Teacher:
    teacher = make_teacher(name)
    knowledge = expert_knowledge(level, space, np.random.default_rng(seed), easy_task=space.low)
    teacher.start(space, knowledge, np.random.default_rng(seed))
    return teacher


def play(teacher: Teacher, episodes: int, step: int = 0) -> list[Task]:
    """Plays a student that gets better with time, best at the lower corner of the space."""
    tasks = []
    for index in range(episodes):
        task = teacher.sample()
        difficulty = float(teacher.space.normalise(task).mean())
        episodic_return = 300 - 400 * difficulty + 0.2 * (step + index)
        teacher.observe(
            Episode(
                task, episodic_return, episodic_return > 230, 100, np.zeros(3, np.float32), 1.0, step + index
            )
        )
        tasks.append(task)
    return tasks
