"""Learner in a thread of this process."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tma_ray.students import Learner
from tma_ray.students.rollout_workers import CohortSettings


@contextmanager
def serving(folder: Path, width: int) -> Iterator[Learner]:
    """Context manager with a learner that listens in a folder."""
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
