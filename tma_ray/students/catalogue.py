"""Registry of students, and checks of hyper-parameters, importable without torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tma_ray.components.registry import Registry, UnknownNameError
from tma_ray.components.settings import config_dict, non_defaults, parse_settings, to_json
from tma_ray.students.base import Policy, Student, checked_spaces
from tma_ray.students.hyperparameters import ALGORITHMS, PACKAGES, PPOHyperparameters, SACHyperparameters
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.support.quantities import PROCESSES
from tma_ray.support.validation import check_type

if TYPE_CHECKING:
    from gymnasium import Space
    from torch import nn

    from tma_ray.students.rollout_workers.base import RolloutWorker
    from tma_ray.students.rollout_workers.link import Learner

STOCK = "stock:"  # prefix of students that use stable-baselines3's own updates, not our faster equivalents


class StudentRegistry(Registry[type[Student]]):
    """Registry of students that also finds the algorithms of stable-baselines3 and sb3-contrib."""

    def names(self) -> list[str]:  # noqa: D102
        return sorted({*super().names(), *ALGORITHMS}, key=lambda name: (name in ALGORITHMS, name))

    def get(self, name: str) -> type[Student]:
        """Return the student class called `name`; case is ignored after ``stock:``.

        Raises:
            UnknownNameError: if `name` is unknown, or its package is not installed.
        """
        name = base_name(name)
        if name in ALGORITHMS and name not in self._decorated:
            from tma_ray.students.sb3.algorithms import student_of  # deferred: imports torch

            return student_of(name)
        if name.startswith(STOCK) and name.lower() not in self._targets:
            raise UnknownNameError(self._explain(name))
        return super().get(name.lower() if name.startswith(STOCK) else name)

    def algorithm_version(self, name: str) -> int | None:  # noqa: D102
        name = base_name(name)
        light = None if name in self._decorated else _BUILTIN_HYPERPARAMETERS.get(name)
        if light is not None:
            return self._checked_version(name, getattr(light, "algorithm_version", None))
        return super().algorithm_version(name)

    def _summary(self, name: str) -> str:
        if name in ALGORITHMS and name not in self._decorated:
            return f"{name} of {PACKAGES[ALGORITHMS[name]]}, with its own networks and updates."
        return super()._summary(name)

    def origin(self, name: str) -> str | None:  # noqa: D102
        name = base_name(name)
        if name not in self._decorated and (name in ALGORITHMS or name.startswith(STOCK)):
            return None
        return super().origin(name)


STUDENTS: Registry[type[Student]] = StudentRegistry(
    "student",
    "tma_ray.students",
    {
        "ppo": "tma_ray.students.ppo:PPO",
        "sac": "tma_ray.students.sac:SAC",
        "stock:ppo": "tma_ray.students.ppo:StockPPO",
        "stock:sac": "tma_ray.students.sac:StockSAC",
    },
    Student,
)

_BUILTIN_HYPERPARAMETERS: dict[str, type] = {"ppo": PPOHyperparameters, "sac": SACHyperparameters}


def make_student(
    name: str,
    observation_space: Space[Any],
    action_space: Space[Any],
    seed: np.random.SeedSequence,
    hyperparameters: Mapping[str, Any] | None = None,
    device: str = "cpu",
    threads: int = 1,
) -> Student:
    """Return a new student called `name`.

    Args:
        name: "ppo", "sac", "stock:ppo", "stock:sac", an algorithm like "TQC", or any registered student.
        observation_space: a one-dimensional box, of size o.
        action_space: a bounded one-dimensional box, of size a.
        seed: source of all randomness, which is not changed.
        hyperparameters: values that differ from `default_hyperparameters`.
        device: torch device of the networks.
        threads: torch threads of the whole process, on whose number results depend.

    Raises:
        UnknownNameError: if no student has this `name`.
        ValueError: if hyper-parameters are unknown or invalid, or the student cannot use the spaces.
    """
    PROCESSES.check("threads", threads)
    check_type("seed", seed, np.random.SeedSequence, "numpy's, as np.random.SeedSequence(0)")
    parsed = check_hyperparameters(name, hyperparameters)
    constructor: Any = STUDENTS.get(name)
    student: Student = constructor(observation_space, action_space, parsed, seed, device, threads)
    return student


COHORT_STUDENTS: Final = {
    "ppo": ("tma_ray.students.rollout_workers.ppo", "PPORolloutWorker"),
    "sac": ("tma_ray.students.rollout_workers.sac", "SACRolloutWorker"),
}
"""Module and class of the rollout worker of each student that can learn in a cohort."""


def make_rollout_worker(
    name: str,
    observation_space: Space[Any],
    action_space: Space[Any],
    seed: np.random.SeedSequence,
    hyperparameters: Mapping[str, Any] | None,
    learner: Learner,
) -> RolloutWorker:
    """Return a new rollout worker that has joined the cohort of `learner`.

    The worker has the initial weights and noise of the student that `make_student` returns for these
    arguments.

    Raises:
        ValueError: if the student cannot learn in a cohort, or `make_student` would raise it.
        LearnerLostError: if no learner listens at the address.
        LearnerError: if the learner has no free slot.
    """
    from tma_ray.students.rollout_workers.link import JoinRequest, LearnerLink  # deferred: imports gymnasium

    if name not in COHORT_STUDENTS:
        raise ValueError(f"student {name!r} cannot learn in a cohort: {', '.join(COHORT_STUDENTS)} can")
    spaces = checked_spaces(observation_space, action_space)
    request = JoinRequest(name, *spaces, check_hyperparameters(name, hyperparameters), seed)
    module, attribute = COHORT_STUDENTS[name]
    worker: RolloutWorker = getattr(import_module(module), attribute)(request, LearnerLink(learner))
    return worker


def default_hyperparameters(name: str) -> dict[str, Any]:
    """Return the default hyper-parameters of the student called `name` as JSON values."""
    values = check_hyperparameters(name)
    return {field.name: to_json(getattr(values, field.name)) for field in dataclasses.fields(values)}


def check_hyperparameters(name: str, overrides: Mapping[str, Any] | None = None) -> Any:
    """Check `overrides`, and return the frozen hyper-parameters of the student called `name`.

    Args:
        name: a student's name, perhaps with hyper-parameters (``sac:learning_rate=3e-4``).
        overrides: further values that differ from the student's defaults.

    Raises:
        UnknownNameError: if no student has this `name`.
        ValueError: if a key is unknown, or a value has a wrong type or is out of range.
    """
    base, settings = split_name(name)
    record = _BUILTIN_HYPERPARAMETERS.get(base) or STUDENTS.get(base).hyperparameters_type
    try:
        return record(**parse_settings(record, settings, overrides))
    except ValueError as error:
        raise ValueError(f"student {base!r}: {error}") from error


def canonical_student(name: str, overrides: Mapping[str, Any] | None = None) -> str:
    """Return the name of a student followed by the hyper-parameters that differ from its defaults.

    Equal students have equal names. Errors are those of `check_hyperparameters`.
    """
    hyperparameters = check_hyperparameters(name, overrides)
    return join_name(base_name(name), non_defaults(type(hyperparameters), config_dict(hyperparameters)))


def load_policy(name: str, folder: Path, device: str = "cpu") -> Policy:
    """Return the greedy policy that the student called `name` saved in `folder`.

    The policy acts as the student did, bit for bit on the same machine with as many threads. The folder may
    come from anywhere: only JSON and safetensors are read, never a pickle.

    Raises:
        UnknownNameError: if no student has this `name`.
        PolicyFileError: if a file was not written by such a student.
    """
    return STUDENTS.get(name).load_policy(folder, device)


def policy_layers(name: str, folder: Path) -> nn.Sequential:
    """Return the layers of the greedy policy that the student called `name` saved in `folder`.

    The layers map raw observations (n, o) to actions (n, a), normalisation and bounds included.

    Raises:
        UnknownNameError: if no student has this `name`.
        PolicyFileError: if a file was not written by such a student.
        ValueError: if the policy is not a sequence of layers, or the student does not define `policy_layers`.
    """
    return STUDENTS.get(name).policy_layers(folder)
