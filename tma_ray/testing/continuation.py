"""Saved teachers played on in a process that knows nothing of the one they come from.

The two processes talk in pickles: a `Job` goes in, the tasks of each continued play come out.
"""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from tma_ray.tasks import KnowledgeLevel, Task
from tma_ray.teachers import Teacher
from tma_ray.testing.playing import Scenario, play


@dataclass(frozen=True)
class Saved:
    """A teacher's state after `episodes` of a scenario, pickled, to be played on to episode `last`."""

    scenario: Scenario
    state: bytes
    episodes: int
    last: int


@dataclass(frozen=True)
class Job:
    """Instructions for the new process: where to find the teacher, and what to play on.

    Attributes:
        module: where the teacher is defined.
        name: what it is called there, dotted when it is defined inside another class.
        hyperparameters: that it is made with.
        level: of its expert knowledge.
        saved: the states to play on.
    """

    module: str
    name: str
    hyperparameters: Mapping[str, Any]
    level: KnowledgeLevel
    saved: tuple[Saved, ...]


START = "import sys; sys.path[:] = sys.argv[1:]; from tma_ray.testing.continuation import main; main()"
"""The new process looks for modules where this one does."""

OTHER_SEED = 99
"""Whatever the new teacher draws at its start, the state replaces."""


def continued(
    teacher: type[Teacher],
    hyperparameters: Mapping[str, Any],
    level: KnowledgeLevel,
    saved: tuple[Saved, ...],
) -> list[Task]:
    """Returns the tasks (n, d) that a new process plays on from each of `saved`.

    Raises:
        RuntimeError: the new process failed; the message holds its errors.
    """
    job = Job(teacher.__module__, teacher.__qualname__, hyperparameters, level, saved)
    command = [sys.executable, "-c", START, *sys.path]
    process = subprocess.run(command, input=pickle.dumps(job), capture_output=True, check=False)  # noqa: S603
    if process.returncode:
        raise RuntimeError(
            f"{teacher.__name__} could not be continued in a new process, which has to find it as "
            f"{teacher.__module__}.{teacher.__qualname__}:\n{process.stderr.decode()}"
        )
    tasks: list[Task] = pickle.loads(process.stdout)
    return tasks


def main() -> None:
    """Plays the job on the standard input; writes a list of tasks (n, d) to the standard output."""
    job: Job = pickle.load(sys.stdin.buffer)
    teacher = attrgetter(job.name)(importlib.import_module(job.module))
    results = []
    for saved in job.saved:
        new = saved.scenario.started(teacher, job.hyperparameters, job.level, OTHER_SEED)
        new.load_state(pickle.loads(saved.state))
        results.append(np.stack(play(new, saved.scenario, saved.episodes, saved.last)))
    sys.stdout.buffer.write(pickle.dumps(results))
