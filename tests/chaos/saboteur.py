"""Environment and teacher whose module injects requested faults into the process that imports it.

A test creates a file in the folder of requests; the first process that reaches the place in the code with
that name removes the file and injects the fault. Workers and driver import this module for the campaign.
"""

import errno
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import corridor
import numpy as np

from tma_ray.results import Store
from tma_ray.results.storage import BucketStore, FolderStore
from tma_ray.results.storage import folder as storing
from tma_ray.runs.evaluation import Evaluation
from tma_ray.tasks import Episode
from tma_ray.teachers.alp_gmm import ALPGMM

REQUESTS = Path(os.environ.get("TMA_SABOTAGE", "/nonexistent"))

WRITES = {
    "kill-in-parts": ("staging/", "episodes.parquet"),
    "kill-in-checkpoint": ("checkpoints/", "run.pickle"),
    "kill-before-index": ("checkpoints/", "index.json"),
    "kill-in-policy": ("staging/", "spec.json"),
    "kill-driver-before-run-row": ("tables/runs/", ""),
    "kill-driver-before-manifest": ("manifests/", ""),
    "kill-driver-before-attempt-row": ("tables/attempts/", ""),
}
"""Parts of a path by fault: a process that is about to write such a file is killed."""

FULL_DISK = "no-space"
HOLD = "hold"
"""Files of lasting faults: all writes fail, or training is slowed down."""


def asked(request: str) -> bool:
    """Remove the request for a fault, and return True if there was one; a single process gets it."""
    try:
        (REQUESTS / request).unlink()
    except FileNotFoundError:
        return False
    return True


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


class Corridor(corridor.Corridor):
    """Corridor in which processes are killed and errors raised on request."""

    evaluating = False

    def __init__(self) -> None:
        super().__init__()
        student = sys.modules.get("tma_ray.students.sac")  # not imported by drivers
        if student is not None and not hasattr(student.SAC, "mined"):
            student.SAC.mined = True
            student.SAC.observe = _before(student.SAC.observe, _observe)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if (REQUESTS / HOLD).exists() and not Corridor.evaluating:
            time.sleep(0.05)
        if asked("kill-in-evaluation" if Corridor.evaluating else "kill-in-step"):
            die()
        if asked("raise-in-environment"):
            raise ZeroDivisionError("an environment's own mistake")
        return super().step(action)


@dataclass
class Teacher(ALPGMM):
    def observe(self, episode: Episode) -> None:
        if asked("kill-teacher"):
            die()
        if asked("raise-in-teacher"):
            raise ZeroDivisionError("a teacher's own mistake")
        super().observe(episode)


def _before(method: Callable[..., Any], act: Callable[..., None]) -> Callable[..., Any]:
    def call(*arguments: Any, **options: Any) -> Any:
        act(*arguments, **options)
        return method(*arguments, **options)

    return call


def _observe(*_: Any) -> None:
    if asked("raise-in-student"):
        raise ZeroDivisionError("a student's own mistake")


def _write(_store: Store, path: str, _data: bytes) -> None:
    for request, (start, end) in WRITES.items():
        if path.startswith(start) and path.endswith(end) and asked(request):
            die()


def _write_file(target: Path, *_: Any, **__: Any) -> None:
    if (REQUESTS / FULL_DISK).exists():
        raise OSError(errno.ENOSPC, "No space left on device", str(target))


def _move(_store: Store, source: str, _destination: str) -> None:
    if "evaluations" in source and asked("kill-driver-between-moves"):
        die()


def _evaluate(evaluate: Callable[..., Any]) -> Callable[..., Any]:
    def call(self: Evaluation, policy: Any) -> Any:
        Corridor.evaluating = True
        try:
            return evaluate(self, policy)
        finally:
            Corridor.evaluating = False

    return call


def _lay_mines() -> None:
    for kind in (FolderStore, BucketStore):
        kind.write_bytes = _before(kind.write_bytes, _write)
        kind.move = _before(kind.move, _move)
    storing.write_file = _before(storing.write_file, _write_file)
    Evaluation.__call__ = _evaluate(Evaluation.__call__)


# Only in processes of a campaign, and once per process: a worker may import two copies of this module.
if REQUESTS.is_dir() and not hasattr(Store, "mined"):
    Store.mined = True
    _lay_mines()
