"""The learner of a cohort as a process of this machine, without Ray."""

from __future__ import annotations

import multiprocessing
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import SpawnProcess
from pathlib import Path

from tma_ray.students import Learner
from tma_ray.students.players import CohortSettings


@contextmanager
def cohort(settings: CohortSettings) -> Iterator[Learner]:
    """Provides a learner in a process of its own, for the placement of runs; ends it with the block."""
    with tempfile.TemporaryDirectory() as folder:
        learner = Learner(f"{folder}/learner", secrets.token_bytes(32))
        process = multiprocessing.get_context("spawn").Process(
            target=_learn, args=(learner, settings), daemon=True
        )
        process.start()
        _wait_for(learner, process)
        try:
            yield learner
        finally:
            process.terminate()
            process.join()


def _learn(learner: Learner, settings: CohortSettings) -> None:
    from tma_ray.students.cohort.server import LearnerServer

    LearnerServer(learner, settings).serve(lambda: False)


def _wait_for(learner: Learner, process: SpawnProcess) -> None:
    while not Path(learner.address).exists():
        if not process.is_alive():
            raise RuntimeError(f"the learner ended with exit code {process.exitcode} before it listened")
        time.sleep(0.05)
