"""Cells of an experiment, and the effective spec that a cell and a seed come down to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np

from tma_ray.benchmark import challenges_of, find_challenge, load_test_set
from tma_ray.envs import make_environment, mastery_return
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.runs.plugins import algorithm_versions_of, plugins_of
from tma_ray.runs.spec import RunSpec, Schedule
from tma_ray.students import check_hyperparameters
from tma_ray.students.hyperparameters import as_plain_values
from tma_ray.tasks import KnowledgeLevel, TaskSpace, TestSet
from tma_ray.teachers import TEACHERS, effective_level, hyperparameters_of, make_teacher

OWN_CHALLENGE = "original"
"""What the task space that an environment declares itself is called."""

OWN_TEST_SET_SIZE = 100
"""Evaluation tasks drawn for an environment that ships none."""


@dataclass(frozen=True)
class Cell:
    """One combination of an experiment; its seeds are runs.

    Attributes:
        environment: registered name, or ``module:Name``.
        challenge: variant of the environment.
        embodiment: name of the body, empty for an environment without bodies.
        student: registered name, or ``module:Name``.
        teacher: registered name, or ``module:Name``.
        expert_knowledge: what the teacher is offered; it may use less.
        teacher_hyperparameters: values that differ from the teacher's defaults.
        student_hyperparameters: values that differ from the student's defaults.
        test_set: name or path of a CSV; None for the challenge's own.
    """

    environment: str = "stump_tracks"
    challenge: str = OWN_CHALLENGE
    embodiment: str = "classic_bipedal"
    student: str = "sac"
    teacher: str = "random"
    expert_knowledge: KnowledgeLevel = KnowledgeLevel.NONE
    teacher_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    student_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    test_set: str | None = None


@dataclass(frozen=True)
class _Setting:
    """What challenge and environment say together."""

    task_space: TaskSpace
    easy_task: tuple[float, ...] | None
    mastery_threshold: float
    test_set: TestSet
    resets: tuple[float, ...]
    cuts: int


def effective_spec(cell: Cell, seed: int, schedule: Schedule, *, independent_levels: bool = False) -> RunSpec:
    """Returns the spec of one run, having refused whatever could not run.

    Args:
        cell: what to run.
        seed: whole number of at least 0.
        schedule: budget and intervals.
        independent_levels: keeps levels of knowledge apart that make no difference to the teacher, as
            repeats with other random numbers; by default such cells share runs.

    Raises:
        ValueError: an unknown name (with the nearest match), a hyper-parameter that does not exist,
            too little knowledge for the teacher, tasks that the environment cannot build, or a budget
            too small for the resets of the student.
    """
    level = effective_level(TEACHERS.get(cell.teacher), cell.teacher, cell.expert_knowledge)
    teacher = make_teacher(cell.teacher, cell.teacher_hyperparameters)
    student = check_hyperparameters(cell.student, cell.student_hyperparameters)
    options = {"embodiment": cell.embodiment} if cell.embodiment else {}
    setting = _setting(cell, options)
    if level is KnowledgeLevel.HIGH and setting.easy_task is None:
        raise ValueError(
            f"{cell.environment} ({cell.challenge}) declares no easy task, so nothing can be told at expert "
            f"knowledge 'high'; use 'low'"
        )
    return RunSpec(
        environment=cell.environment,
        environment_options=options,
        challenge=cell.challenge,
        task_space=setting.task_space,
        easy_task=setting.easy_task,
        mastery_threshold=setting.mastery_threshold,
        test_set=setting.test_set,
        student=cell.student,
        student_hyperparameters=as_plain_values(student),
        teacher=cell.teacher,
        teacher_hyperparameters=hyperparameters_of(teacher),
        expert_knowledge=level,
        schedule=schedule,
        seed=seed,
        repeat=cell.expert_knowledge.value if independent_levels else "",
        physics_version=PHYSICS_VERSION,
        plugins=plugins_of(vars(cell)),
        resets=tuple(round(share * schedule.steps) for share in setting.resets),
        cuts=setting.cuts,
        algorithm_versions=algorithm_versions_of(vars(cell)),
    )


def _setting(cell: Cell, options: Mapping[str, Any]) -> _Setting:
    environment = make_environment(cell.environment, **options)
    try:
        _check_spaces(cell, environment)
        own_space: TaskSpace = environment.get_wrapper_attr("task_space")
        domain: TaskSpace = environment.get_wrapper_attr("valid_domain")
        threshold = mastery_return(environment)
        body_type = _body_type(environment)
    finally:
        environment.close()
    if challenges_of(cell.environment) or cell.challenge != OWN_CHALLENGE:
        challenge = find_challenge(cell.environment, cell.challenge)
        space, easy_task = challenge.task_space, challenge.easy_task
        resets, cuts = challenge.resets, challenge.cuts
        tests = load_test_set(challenge.test_set_of(body_type))
    else:
        space, easy_task, tests = own_space, None, _own_test_set(cell.environment, own_space)
        resets, cuts = (), 0
    if cell.test_set is not None:
        tests = load_test_set(cell.test_set)
    tests.check(domain)
    for corner in (space.low, space.high):
        if space.names != domain.names or not domain.contains(corner):
            raise ValueError(
                f"the task space of {cell.challenge!r} exceeds the valid domain at {corner.tolist()}"
            )
    return _Setting(space, easy_task, threshold, tests, resets, cuts)


def _body_type(environment: gymnasium.Env[Any, Any]) -> str:
    """Returns how the body of `environment` moves, empty for an environment without bodies."""
    if not environment.has_wrapper_attr("embodiment"):
        return ""
    return str(environment.get_wrapper_attr("embodiment").body_type)


def _check_spaces(cell: Cell, environment: gymnasium.Env[Any, Any]) -> None:
    for kind, space in (("observation", environment.observation_space), ("action", environment.action_space)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise ValueError(
                f"environment {cell.environment!r} has the {kind} space {space}; students need a "
                f"one-dimensional Box"
            )


def _own_test_set(name: str, space: TaskSpace) -> TestSet:
    """The same tasks for everybody: a grid where that is small enough, else uniform draws."""
    if space.size <= 2:
        return TestSet.grid(name, space, OWN_TEST_SET_SIZE if space.size == 1 else 10)
    return TestSet(name, space.names, space.sample(np.random.default_rng(0), OWN_TEST_SET_SIZE))
