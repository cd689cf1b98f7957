"""Short trajectories of all shipped teachers, students and environments, reduced to a few numbers.

A hash of a trajectory would differ between machines, whose processors round sums differently. A trace is
instead a row of weighted means over the whole trajectory, which a change of behaviour moves by far more than
rounding does.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tma_ray.embodiments import embodiment_names
from tma_ray.envs import ENVIRONMENTS, make_environment
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.students import STUDENTS
from tma_ray.tasks import Episode, KnowledgeLevel, Outcomes, TaskSpace, expert_knowledge
from tma_ray.teachers import TEACHERS, make_teacher
from tma_ray.testing.students import report_episode

NUMBERS = 4
"""Number of weighted means in a trace."""

TOLERANCE = 2e-5
"""Largest difference due to rounding. One or two threads, and instructions of processors with AVX-512 or
without AVX (in numpy, OpenBLAS, torch, oneDNN and numba), differ by at most 6e-7."""

EPISODES, EPISODE_LENGTH = 150, 2_000
"""Number of episodes of a teacher's trajectory, and number of steps of an episode."""

SPACE = TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6), "level": (-1, 1)})

TEACHER_SIZES: dict[str, dict[str, Any]] = {
    "adr": {"queue_size": 4},
    "alp_gmm": {"fit_every": 40, "most_components": 3},
    "covar_gmm": {"fit_every": 40, "most_components": 3},
    "currot": {"particles": 40, "update_every": 20},
    "doraemon": {"update_every": 50_000},
    "goal_gan": {"train_every": 30, "iterations_per_task": 0.3, "pretraining_iterations": 20},
    "accel": {"buffer_size": 20},
    "plr": {"buffer_size": 20},
    "riac": {"region_capacity": 30, "split_attempts": 10},
    "ramp": {"steps": 200_000},
    "robust_plr": {"buffer_size": 20, "score": "max_mc"},
    "setter_solver": {"update_every": 30, "hidden_units": 16},
    "sfl": {"candidates": 20, "rollouts": 2, "kept": 5, "refresh_every": 50},
    "spdl": {"first_update": 40_000, "update_every": 40_000},
    "lp_acrl": {"cells": 8, "stage_episodes": 40},
    "perm": {"window_episodes": 40, "bumps": 10},
    "procurl_target": {"first_update": 60_000, "update_every": 80_000, "pool_size": 50},
    "spgl": {"first_update": 40_000, "update_every": 40_000},
    "traced": {"buffer_size": 20, "round_size": 2},
}
"""Hyper-parameters that show all behaviour within 150 episodes; others are the defaults."""

STUDENT_STEPS, ENVIRONMENT_STEPS = 130, 40

ENVIRONMENT_TASKS = {
    "stump_tracks": (0.5, 1.0),
    "parkour": (-0.1, 0.9, 0.1, 0.4, 0.25, 1.5, 1.0, 10.0),
}


def trace(values: ArrayLike) -> list[float]:
    """Return `NUMBERS` weighted means of values (n, d), scaled by the root mean squares of columns."""
    rows = np.asarray(values, dtype=np.float64)
    assert np.isfinite(rows).all()
    scale = np.sqrt(np.mean(rows**2, axis=0))
    rows = rows / np.where(scale > 0, scale, 1)
    weights = np.random.default_rng(0).uniform(-1, 1, (NUMBERS, rows.size))
    return [float(f"{value:.7f}") for value in weights @ rows.ravel() / np.sqrt(rows.size)]


def teacher_traces(name: str) -> dict[str, list[float]]:
    """Return the traces of a teacher's tasks by level of expert knowledge that it uses."""
    return {level.value: trace(_tasks(name, level)) for level in TEACHERS.get(name).knowledge_levels}


def student_traces(name: str) -> dict[str, list[float]]:
    """Return the traces of a student: actions during training, and final greedy actions."""
    from students_support import Drift, small_student, train  # deferred: scripts extend sys.path first

    student = small_student(name)
    actions = [step.action for step in train(student, Drift(), STUDENT_STEPS)]
    asked = np.random.default_rng(1).normal(size=(20, 3)).astype(np.float32)
    values = student.state_values(asked)
    return {
        "exploring": trace(actions),
        "greedy": trace(student.act_greedily(asked)),
        "values": trace(values[:, None]),
    }


def environment_traces(name: str) -> dict[str, list[float]]:
    """Return the traces of observations and rewards under random actions, by body."""
    return {body: trace(_steps(name, body)) for body in embodiment_names()}


def traces(part: str, name: str) -> dict[str, list[float]]:
    """Return the traces of a "teacher", "student" or "environment", by level, quantity or body."""
    of = {"teacher": teacher_traces, "student": student_traces, "environment": environment_traces}
    return of[part](name)


def catalogue() -> list[tuple[str, str]]:
    """Return part and name of all shipped components, without registered plug-ins."""
    registries = {"environment": ENVIRONMENTS, "student": STUDENTS, "teacher": TEACHERS}
    return [
        (part, name)
        for part, registry in registries.items()
        for name in registry.names()
        if registry.origin(name) is None
    ]


def version(part: str, name: str) -> str:
    """Return the version of a component, for environments with that of the physics."""
    registry: Any = {"environment": ENVIRONMENTS, "student": STUDENTS, "teacher": TEACHERS}[part]
    own = registry.algorithm_version(name)
    return f"{own}, physics {PHYSICS_VERSION}" if part == "environment" else str(own)


def _tasks(name: str, level: KnowledgeLevel) -> list[Any]:
    teacher = make_teacher(name, TEACHER_SIZES.get(name, {}))
    knowledge = expert_knowledge(level, SPACE, np.random.default_rng(1), easy_task=SPACE.low)
    teacher.start(SPACE, knowledge, np.random.default_rng(0))
    noise = np.random.default_rng(2)
    tasks = []
    for index in range(EPISODES):
        proposal = teacher.propose()
        task, gained = proposal.task, _return(proposal.task, index) + noise.normal(0, 20)
        episode = Episode(
            task=task,
            episodic_return=gained,
            success=gained > 230,
            length=EPISODE_LENGTH,
            initial_observation=np.array([SPACE.normalise(task).mean(), 0, 0], dtype=np.float32),
            discounted_return=gained / 5,
            step=EPISODE_LENGTH * (index + 1),
            trains=proposal.trains,
        )
        report_episode(teacher, episode, _values, partial(_outcomes, index))
        tasks.append(task)
    return [*tasks, *teacher.probe(20)]


def _return(task: Any, index: int) -> float:
    return 300 - 400 * float(SPACE.normalise(task).mean()) + 1.2 * index


def _values(observations: Any) -> Any:
    return 60 - 80 * observations[:, 0].astype(np.float64)


def _outcomes(index: int, tasks: Any, _greedy: bool) -> Outcomes:
    gained = np.array([_return(task, index) + 60 * (-1) ** place for place, task in enumerate(tasks)])
    return Outcomes(gained, gained > 230, np.full(len(tasks), EPISODE_LENGTH))


def _steps(name: str, body: str) -> list[Any]:
    environment = make_environment(name, embodiment=body)
    rng, task = np.random.default_rng(0), list(ENVIRONMENT_TASKS[name])
    observation, _ = environment.reset(seed=3, options={"task": task})
    rows = [[*observation, 0.0]]
    for _ in range(ENVIRONMENT_STEPS):
        action = rng.uniform(-1, 1, environment.action_space.shape).astype(np.float32)
        observation, reward, terminated, _, _ = environment.step(action)
        rows.append([*observation, float(reward)])
        if terminated:
            observation, _ = environment.reset(options={"task": task})
            rows.append([*observation, 0.0])
    environment.close()
    return rows
