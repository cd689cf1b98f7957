"""Cells of an experiment, and the specs of their runs."""

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from tma_ray.benchmark import challenges_of, find_challenge, load_test_set
from tma_ray.components.settings import config_dict, json_value, non_defaults, parameters_of, parse_settings
from tma_ray.envs import ENVIRONMENTS, make_environment, mastery_return
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.runs.inputs import algorithm_versions_of, captured, named, plugins_of
from tma_ray.runs.spec import RunSpec, Schedule
from tma_ray.students import STUDENTS, Student, canonical_student, check_hyperparameters
from tma_ray.support.component_names import base_name, join_name, nearest, split_name, text_of
from tma_ray.support.validation import check_fields, check_type
from tma_ray.tasks import KnowledgeLevel, TaskSpace, TestSet
from tma_ray.teachers import (
    TEACHERS,
    canonical_teacher,
    check_limits,
    effective_level,
    hyperparameters_of,
    make_teacher,
)

BOUNDS_SEPARATOR = ".."  # separates a dimension's low and high bound in the name of a challenge
Bounds = Mapping[str, Sequence[float]]  # low and high bounds by dimension

_ELSEWHERE = {"embodiment": "--embodiment or Cell.embodiment", "render_mode": "no run; runs draw nothing"}
"""Constructor parameters of environments that are not options of a cell, and where to set them."""


def environment_settings(name: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the canonical name of an environment and the options that differ from its defaults.

    Args:
        name: registered name or ``module:Name``, optionally with options, as in
            ``parkour:swinging_creepers=true``.
        options: further options of its constructor.

    Raises:
        UnknownNameError: if the environment is unknown.
        ValueError: if an option is unknown or set elsewhere, or a value has another type.
    """
    base, text = split_name(name)
    environment = ENVIRONMENTS.get(base)
    for option in (*text, *options):
        if option in _ELSEWHERE:
            raise ValueError(f"environment {base!r}: {option} cannot be set here; use {_ELSEWHERE[option]}")
    try:
        chosen = non_defaults(environment, parse_settings(environment, text, options, "option"))
        values = {option: json_value(option, value, "option") for option, value in chosen.items()}
    except ValueError as error:
        raise ValueError(f"environment {base!r}: {error}") from error
    return join_name(base, values), values


def check_body(environment: str, embodiment: str) -> None:
    """Check that a body is given if and only if the environment takes one.

    Raises:
        UnknownNameError: if the environment is unknown.
        ValueError: if a body is missing or superfluous.
    """
    base = base_name(environment)
    factory = ENVIRONMENTS.get(base)
    parameters = inspect.signature(factory).parameters.values()
    if not embodiment and "embodiment" in parameters_of(factory):
        raise ValueError(
            f"environment {base!r} has bodies: choose one with {_ELSEWHERE['embodiment']}, not ''"
        )
    any_option = any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters)
    if embodiment and not any_option and "embodiment" not in parameters_of(factory):
        raise ValueError(
            f"environment {base!r} has no bodies, and cannot be given {embodiment!r}: choose none, '', with "
            f"{_ELSEWHERE['embodiment']}"
        )


def challenge_bounds(name: str, space: Bounds) -> tuple[str, dict[str, tuple[float, float]]]:
    """Return a challenge's name without bounds, and all bounds given in its name and in `space`.

    Args:
        name: name of a challenge, optionally with bounds, as in ``original:stump_height=0..0.3``.
        space: further bounds.

    Raises:
        ValueError: if bounds are not two numbers, or given twice.
    """
    base, text = split_name(name)
    twice = sorted(set(text) & set(space))
    if twice:
        raise ValueError(f"challenge {name!r}: the bounds of {twice[0]} are given twice; give them once")
    named_bounds = {dimension: value.split(BOUNDS_SEPARATOR) for dimension, value in text.items()}
    bounds = {}
    for dimension, values in {**named_bounds, **space}.items():
        try:
            low, high = map(float, values)  # type: ignore[arg-type] # refused below
        except (TypeError, ValueError):
            low = high = math.nan
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ValueError(f"bounds {values!r} of {dimension}: expected two numbers, low and high")
        bounds[dimension] = low, high
    return base, bounds


def bounded(space: TaskSpace, bounds: Bounds) -> TaskSpace:
    """Return `space` with the bounds of the dimensions in `bounds` replaced.

    Raises:
        ValueError: if a dimension is unknown, or its low bound is over the high one.
    """
    for dimension, (low, high) in bounds.items():
        if dimension not in space.names:
            hint = nearest(dimension, space.names)
            raise ValueError(f"unknown dimension {dimension!r}: {hint}known: {', '.join(space.names)}")
        current = space.dimensions[space.names.index(dimension)]
        if (current.low, current.high) != (low, high):
            space = space.with_bounds(dimension, low, high)
    return space


def canonical_challenge(name: str, space: TaskSpace, chosen: TaskSpace) -> str:
    """Return a challenge's name with those bounds of `chosen` that differ from the challenge's `space`."""
    pairs = zip(space.dimensions, chosen.dimensions, strict=True)
    differing = {
        new.name: f"{text_of(float(new.low))}{BOUNDS_SEPARATOR}{text_of(float(new.high))}"
        for old, new in pairs
        if (old.low, old.high) != (new.low, new.high)
    }
    return join_name(base_name(name), differing)


OWN_CHALLENGE = "original"  # name of the challenge with the task space that an environment declares
OWN_TEST_SET_SIZE = 100  # number of test tasks of an environment without a shipped test set


@dataclass(frozen=True)
class Cell:
    """Combination of components in an experiment; each seed gives one run.

    Names may have settings, as in ``alp_gmm:fit_every=100`` or ``module:Name:key=value``; see
    `tma_ray.support.component_names`. Runs and tables have canonical names, with only the settings that
    differ from the defaults.

    Attributes:
        environment: registered name, or ``module:Name``.
        challenge: variant of the environment.
        embodiment: name of the body, empty for an environment without bodies.
        student: registered name, or ``module:Name``.
        teacher: registered name, or ``module:Name``.
        expert_knowledge: level offered to the teacher, which may use less.
        teacher_hyperparameters: values that differ from the teacher's defaults.
        student_hyperparameters: values that differ from the student's defaults.
        test_set: name or path, as for `tma_ray.benchmark.load_test_set`; None for the challenge's own.
        environment_options: values that differ from the environment's defaults.
        space: bounds (low, high) of dimensions that differ from the challenge's task space.
    """

    environment: str = "stump_tracks"
    challenge: str = OWN_CHALLENGE
    embodiment: str = "classic_bipedal"
    student: str = "sac"
    teacher: str = "random"
    expert_knowledge: KnowledgeLevel = KnowledgeLevel.NONE
    teacher_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    student_hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    test_set: str | Path | None = None
    environment_options: Mapping[str, Any] = field(default_factory=dict)
    space: Bounds = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "expert_knowledge", KnowledgeLevel(self.expert_knowledge))


def effective_spec(cell: Cell, seed: int, schedule: Schedule, *, independent_levels: bool = False) -> RunSpec:
    """Return the spec of a run, after checking that the run is possible.

    Args:
        cell: combination to run.
        seed: whole number of at least 0.
        schedule: budget and intervals.
        independent_levels: True to repeat runs whose levels of knowledge make no difference to the teacher,
            with other random numbers; by default such cells share runs.

    Raises:
        ValueError: if a name or hyper-parameter is unknown, the teacher lacks knowledge, the task space
            exceeds its limits, the environment cannot build a task, or the budget is too small for resets.
    """
    check_type("cell", cell, Cell, "a Cell(teacher=...)")
    level = effective_level(TEACHERS.get(cell.teacher), cell.teacher, cell.expert_knowledge)
    teacher = make_teacher(cell.teacher, cell.teacher_hyperparameters)
    student = check_hyperparameters(cell.student, cell.student_hyperparameters)
    shipped = STUDENTS.origin(base_name(cell.student)) is None  # shipped students define sample_actions
    if teacher.wants_evaluations and not shipped:
        plays = getattr(STUDENTS.get(cell.student), "sample_actions", None)
        if plays in (None, Student.sample_actions):
            raise ValueError(
                f"teacher {cell.teacher!r} has episodes played from which the student does not learn, and "
                f"student {cell.student!r} does not define sample_actions, which chooses the actions there: "
                f"define it, or choose another teacher"
            )
    environment, options = environment_settings(cell.environment, cell.environment_options)
    body = {"embodiment": cell.embodiment} if cell.embodiment else {}
    canonical_body, world = _world(cell, options | body)
    check_limits(type(teacher), cell.teacher, world["task_space"])
    if level is KnowledgeLevel.HIGH and world["easy_task"] is None:
        raise ValueError(
            f"{environment} ({world['challenge']}) declares no easy task within its task space, on which "
            f"expert knowledge 'high' is based; use 'low'"
        )
    resets = tuple(round(share * schedule.steps) for share in world.pop("resets"))
    options, inputs = captured("environment", options | (body and {"embodiment": canonical_body}))
    student_values, student_inputs = captured("student", config_dict(student))
    teacher_values, teacher_inputs = captured("teacher", hyperparameters_of(teacher))
    return RunSpec(
        environment=named("environment", environment),
        environment_options=options,
        student=named("student", canonical_student(cell.student, cell.student_hyperparameters)),
        student_hyperparameters=student_values,
        teacher=named("teacher", canonical_teacher(cell.teacher, cell.teacher_hyperparameters)),
        teacher_hyperparameters=teacher_values,
        expert_knowledge=level,
        schedule=schedule,
        seed=seed,
        repeat=cell.expert_knowledge.value if independent_levels else "",
        physics_version=PHYSICS_VERSION,
        plugins=plugins_of(vars(cell)),
        resets=resets,
        algorithm_versions=algorithm_versions_of(vars(cell)),
        inputs=inputs | student_inputs | teacher_inputs,
        **world,
    )


def _world(cell: Cell, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the body's canonical name, and the spec fields that challenge and environment determine.

    Resets are given as shares of the budget.
    """
    check_body(cell.environment, cell.embodiment)
    environment = make_environment(cell.environment, **options)
    try:
        _check_spaces(cell, environment)
        own_space: TaskSpace = environment.get_wrapper_attr("task_space")
        domain: TaskSpace = environment.get_wrapper_attr("valid_domain")
        threshold = mastery_return(environment)
        body_type, body = "", cell.embodiment
        if environment.has_wrapper_attr("embodiment"):
            embodiment = environment.get_wrapper_attr("embodiment")
            body_type = str(embodiment.body_type)
            body = join_name(base_name(body), split_name(embodiment.name)[1])
    finally:
        environment.close()
    name, bounds = challenge_bounds(cell.challenge, cell.space)
    if challenges_of(cell.environment) or name != OWN_CHALLENGE:
        challenge = find_challenge(cell.environment, name)
        own_space, easy_task = challenge.task_space, challenge.easy_task
        resets, cuts = challenge.resets, challenge.cuts
        tests = load_test_set(challenge.test_set_of(body_type))
    else:
        easy_task, tests = None, _own_test_set(base_name(cell.environment), own_space)
        resets, cuts = (), 0
    space = bounded(own_space, bounds)
    if easy_task is not None and not space.contains(easy_task):
        easy_task = None
    if cell.test_set is not None:
        tests = load_test_set(cell.test_set)
    tests.check(domain)
    canonical = canonical_challenge(name, own_space, space)
    for corner in (space.low, space.high):
        if space.names != domain.names or not domain.contains(corner):
            raise ValueError(f"the task space of {canonical!r} exceeds the valid domain at {corner.tolist()}")
    return body, {
        "challenge": canonical,
        "task_space": space,
        "easy_task": easy_task,
        "mastery_threshold": threshold,
        "test_set": tests,
        "resets": resets,
        "cuts": cuts,
    }


def _check_spaces(cell: Cell, environment: gymnasium.Env[Any, Any]) -> None:
    for kind, space in (("observation", environment.observation_space), ("action", environment.action_space)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise ValueError(
                f"environment {cell.environment!r} has the {kind} space {space}; students need a "
                f"one-dimensional Box"
            )


def _own_test_set(name: str, space: TaskSpace) -> TestSet:
    """Return a test set for an environment without one: a grid in up to two dimensions, else random tasks."""
    if space.size <= 2:
        return TestSet.grid(name, space, OWN_TEST_SET_SIZE if space.size == 1 else 10)
    return TestSet(name, space.names, space.sample(np.random.default_rng(0), OWN_TEST_SET_SIZE))
