"""Kinds of runs: those of one kind can learn in one stack."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

from tma_ray.envs import make_environment
from tma_ray.part_names import base_name
from tma_ray.runs.inputs import arguments
from tma_ray.runs.plugins import import_plugins
from tma_ray.runs.spec import RunSpec
from tma_ray.students.players import COHORT_STUDENTS
from tma_ray.students.spaces import checked_spaces


class Kind(NamedTuple):
    """All on which the shapes and the settings of a stacked learner depend.

    Attributes:
        student: name of its algorithm.
        observation: length of an observation.
        action: length of an action.
        hyperparameters: of the student, as text.
    """

    student: str
    observation: int
    action: int
    hyperparameters: str


def kinds_of(specs: Sequence[RunSpec]) -> dict[str, Kind]:
    """Returns the kind of each run by its id; makes every environment once.

    Raises:
        ValueError: a student that cannot learn in a cohort, or spaces that it does not take.
    """
    sizes: dict[Hashable, tuple[int, int]] = {}
    kinds = {}
    for spec in specs:
        student = base_name(spec.student)
        if student not in COHORT_STUDENTS:
            raise ValueError(
                f"student {spec.student!r} cannot learn in a cohort, as {' and '.join(COHORT_STUDENTS)} can: "
                f"add '--cohort off', with '--gpus-per-run' on a GPU"
            )
        recipe = spec.environment, repr(sorted(spec.environment_options.items())), *spec.inputs.items()
        if recipe not in sizes:
            sizes[recipe] = _sizes(spec)
        kinds[spec.run_id] = Kind(student, *sizes[recipe], repr(sorted(spec.student_hyperparameters.items())))
    return kinds


def _sizes(spec: RunSpec) -> tuple[int, int]:
    import_plugins(spec, "environment")
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    observations, actions = checked_spaces(environment.observation_space, environment.action_space)
    environment.close()
    return observations.shape[0], actions.shape[0]
