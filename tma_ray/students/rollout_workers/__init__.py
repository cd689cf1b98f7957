"""Acting halves of students, also for networks that learn in another process, without torch."""

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
