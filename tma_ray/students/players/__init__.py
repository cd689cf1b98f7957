"""Students whose networks learn in another process: they act and collect. They import no torch."""

from tma_ray.students.players.catalogue import COHORT_STUDENTS, make_player, player_class
from tma_ray.students.players.link import (
    CohortFullError,
    CohortSettings,
    JoinRequest,
    Learner,
    LearnerError,
    LearnerLink,
    LearnerLostError,
    PlayerState,
    ask_learner,
)

__all__ = [
    "COHORT_STUDENTS",
    "CohortFullError",
    "CohortSettings",
    "JoinRequest",
    "Learner",
    "LearnerError",
    "LearnerLink",
    "LearnerLostError",
    "PlayerState",
    "ask_learner",
    "make_player",
    "player_class",
]
