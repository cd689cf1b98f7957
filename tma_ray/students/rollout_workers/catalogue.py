"""Catalogue of the students that can learn in a cohort, without torch."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gymnasium import Space

from tma_ray.students.base import checked_spaces
from tma_ray.students.catalogue import check_hyperparameters
from tma_ray.students.rollout_workers.link import JoinRequest, Learner, LearnerLink

if TYPE_CHECKING:
    from tma_ray.students.rollout_workers.base import RolloutWorker

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

    Args:
        name: a key of `COHORT_STUDENTS`.
        observation_space: a one-dimensional box, of size o.
        action_space: a bounded one-dimensional box, of size a.
        seed: source of all randomness, with the same initial weights and noise as in `make_student`.
        hyperparameters: values that differ from the student's defaults.
        learner: learner of the cohort.

    Raises:
        ValueError: if the student cannot learn in a cohort, or `make_student` would raise it.
        LearnerLostError: if no learner listens at the address.
        LearnerError: if the learner has no free slot.
    """
    if name not in COHORT_STUDENTS:
        raise ValueError(f"student {name!r} cannot learn in a cohort: {', '.join(COHORT_STUDENTS)} can")
    spaces = checked_spaces(observation_space, action_space)
    request = JoinRequest(name, *spaces, check_hyperparameters(name, hyperparameters), seed)
    return worker_class(name)(request, LearnerLink(learner))


def worker_class(name: str) -> type[RolloutWorker]:
    """Return the rollout worker class of a student of `COHORT_STUDENTS`, importing it."""
    module, attribute = COHORT_STUDENTS[name]
    worker: type[RolloutWorker] = getattr(import_module(module), attribute)
    return worker
