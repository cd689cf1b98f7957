"""A learner in a thread of this process, and learner actors for which memory does not suffice."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tma_ray.campaign.placing.learner import LearnerActor
from tma_ray.students import Learner
from tma_ray.students.players import CohortSettings

ENOUGH_FOR = 2
"""Slots for which memory suffices."""


@contextmanager
def serving(folder: Path, width: int) -> Iterator[Learner]:
    """Lends the block a learner, which listens in a folder."""
    from tma_ray.students.cohort.server import LearnerServer

    learner, over = Learner(f"{folder}/learner", b"secret"), threading.Event()
    server = LearnerServer(learner, CohortSettings(width=width))
    thread = threading.Thread(target=server.serve, args=(over.is_set, 0.02))
    thread.start()
    try:
        yield learner
    finally:
        over.set()
        thread.join()


class CrampedLearner(LearnerActor):
    """A learner whose process has memory for a few slots only."""

    def _work(self) -> None:
        from tma_ray.students.cohort import replay

        allocate = replay.empty

        def cramped(shape: tuple[int, ...], *arguments: Any) -> Any:
            if shape[0] > ENOUGH_FOR:
                raise MemoryError(f"Unable to allocate an array with shape {shape}")
            return allocate(shape, *arguments)

        replay.empty = cramped
        super()._work()
