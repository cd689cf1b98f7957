"""PLR and robust PLR, prioritised level replay (Jiang et al. 2021a, 2021b)."""

from dataclasses import dataclass
from typing import ClassVar

from tma_ray.teachers.prioritised_replay import PrioritisedReplay


@dataclass
class PLR(PrioritisedReplay):
    """Teacher that replays tasks by score rank and staleness; the student also learns from new tasks.

    Source: Jiang et al. 2021a, algorithm 1, with the buffer and the scores of 2021b, appendix C.
    """

    algorithm_version: ClassVar[int | None] = 1


@dataclass
class RobustPLR(PrioritisedReplay):
    """PLR in which the student learns only from replayed tasks; new tasks are only scored.

    Source: Jiang et al. 2021b, algorithm 1. About half of the budget's steps train.
    """

    withholds_episodes: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    wants_evaluations: ClassVar[bool] = True
    new_tasks_train: ClassVar[bool] = False
