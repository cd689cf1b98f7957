"""Learner actor with too little memory."""

from typing import Any

from tma_ray.campaign.executors.actors import LearnerActor

ENOUGH_FOR = 2
"""Number of slots that fit into memory."""


class CrampedLearner(LearnerActor):
    """Learner actor with memory for a few slots."""

    def _work(self) -> None:
        from tma_ray.students.cohort import replay

        allocate = replay.empty

        def cramped(shape: tuple[int, ...], *arguments: Any) -> Any:
            if shape[0] > ENOUGH_FOR:
                raise MemoryError(f"Unable to allocate an array with shape {shape}")
            return allocate(shape, *arguments)

        replay.empty = cramped
        super()._work()
