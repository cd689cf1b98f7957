"""Students by name. Names and hyper-parameters are checked without importing torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tma_ray.components.registry import Registry, UnknownNameError
from tma_ray.components.settings import config_dict, non_defaults, parse_settings, to_json
from tma_ray.students.base import Policy, Student
from tma_ray.students.hyperparameters import ALGORITHMS, PACKAGES, PPOHyperparameters, SACHyperparameters
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.support.quantities import PROCESSES
from tma_ray.support.validation import check_type

if TYPE_CHECKING:
    from gymnasium import Space
    from torch import nn

STOCK = "stock:"  # before a name: updated by stable-baselines3 itself, not by our equal but leaner code


class StudentRegistry(Registry[type[Student]]):
    """Students by name, and the algorithms of stable-baselines3 and sb3-contrib by theirs."""

    def names(self) -> list[str]:  # noqa: D102
        return sorted({*super().names(), *ALGORITHMS}, key=lambda name: (name in ALGORITHMS, name))

    def get(self, name: str) -> type[Student]:
        """Return the student called `name`; ``stock:SAC`` and ``stock:sac`` are one.

        Raises:
            UnknownNameError: nothing answers to `name`, or its package is not installed.
        """
        name = base_name(name)
        if name in ALGORITHMS and name not in self._decorated:
            from tma_ray.students.sb3.algorithms import student_of  # it imports torch

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
    """Return a new student.

    Args:
        name: "ppo", "sac", "stock:ppo", "stock:sac", an algorithm like "TQC", or any registered student.
        observation_space: a one-dimensional box, of size o.
        action_space: a bounded one-dimensional box, of size a.
        seed: source of all its randomness; not changed, so that the same seed gives the same student.
        hyperparameters: values that differ from `default_hyperparameters`.
        device: torch's name of where networks live.
        threads: torch's threads, for the whole process; results are repeatable for one number of them.

    Raises:
        UnknownNameError: no student answers to `name`.
        ValueError: unknown or unfit hyper-parameters, or spaces that the student cannot use.
    """
    PROCESSES.check("threads", threads)
    check_type("seed", seed, np.random.SeedSequence, "numpy's, as np.random.SeedSequence(0)")
    parsed = check_hyperparameters(name, hyperparameters)
    constructor: Any = STUDENTS.get(name)
    student: Student = constructor(observation_space, action_space, parsed, seed, device, threads)
    return student


def default_hyperparameters(name: str) -> dict[str, Any]:
    """Return all hyper-parameters of the student called `name` at their defaults, fit for JSON."""
    values = check_hyperparameters(name)
    return {field.name: to_json(getattr(values, field.name)) for field in dataclasses.fields(values)}


def check_hyperparameters(name: str, given: Mapping[str, Any] | None = None) -> Any:
    """Return the frozen hyper-parameters of the student called `name` with the values `given`.

    Args:
        name: a student's name, with hyper-parameters if wanted (``sac:learning_rate=3e-4``).
        given: further values that differ from the student's defaults.

    Raises:
        UnknownNameError: no student answers to `name`.
        ValueError: an unknown key, a wrong type or a value outside its range.
    """
    base, settings = split_name(name)
    kind = _BUILTIN_HYPERPARAMETERS.get(base) or STUDENTS.get(base).hyperparameters_type
    try:
        return kind(**parse_settings(kind, settings, given))
    except ValueError as error:
        raise ValueError(f"student {base!r}: {error}") from error


def canonical_student(name: str, given: Mapping[str, Any] | None = None) -> str:
    """Return the name of a student with the hyper-parameters that differ from its defaults.

    Equal students have equal names: see `tma_ray.support.component_names`. Raises as `check_hyperparameters`.
    """
    hyperparameters = check_hyperparameters(name, given)
    return join_name(base_name(name), non_defaults(type(hyperparameters), config_dict(hyperparameters)))


def load_policy(name: str, folder: Path, device: str = "cpu") -> Policy:
    """Return the greedy policy that a student called `name` saved in `folder`.

    It acts as the student did, bit for bit on the same machine with as many threads. The folder may come
    from anywhere: what is read is JSON and safetensors, never a pickle.

    Raises:
        UnknownNameError: no student answers to `name`.
        PolicyFileError: a file that no such student wrote.
    """
    return STUDENTS.get(name).load_policy(folder, device)


def policy_layers(name: str, folder: Path) -> nn.Sequential:
    """Return the layers of the greedy policy that a student called `name` saved in `folder`.

    That is a row of torch's layers and those of `tma_ray.students.layers`, which takes raw
    observations (n, o) and returns actions (n, a): normalisation and bounds are among them.

    Raises:
        UnknownNameError: no student answers to `name`.
        PolicyFileError: a file that no such student wrote.
        ValueError: the policy is not a row of layers, or its student does not tell.
    """
    return STUDENTS.get(name).policy_layers(folder)
