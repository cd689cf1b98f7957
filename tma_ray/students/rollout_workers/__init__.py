"""Rollout workers: students that act without torch while their networks learn in another process."""

from tma_ray.students.rollout_workers.link import (
    CohortFullError,
    CohortSettings,
    JoinRequest,
    Learner,
    LearnerError,
    LearnerLink,
    LearnerLostError,
    WorkerState,
    ask_learner,
)

__all__ = [
    "CohortFullError",
    "CohortSettings",
    "JoinRequest",
    "Learner",
    "LearnerError",
    "LearnerLink",
    "LearnerLostError",
    "WorkerState",
    "ask_learner",
]
