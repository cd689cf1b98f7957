"""Misbehaving teachers, named as ``misbehaving:Name``.

They look for files in a folder, since a file named by a hyper-parameter would be an input of the run.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers.random import Random
from tma_ray.teachers.riac import RIAC


@dataclass
class Raising(Random):
    """Teacher that raises an error in `sample`."""

    def sample(self) -> Task:
        raise ZeroDivisionError("a teacher's own mistake")


@dataclass
class Unstartable(Random):
    """Teacher that raises an error in `start`."""

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        raise ZeroDivisionError("a teacher's own mistake at its start")


@dataclass
class Waiting(Random):
    """Teacher that raises an error until a file `needed` is in a folder."""

    folder: str = ""

    def sample(self) -> Task:
        if not Path(self.folder, "needed").exists():
            raise FileNotFoundError(f"{self.folder}/needed is missing")
        return super().sample()


@dataclass
class Lingering(RIAC):
    """Teacher that slows down late episodes until a file `stopped` is in a folder."""

    folder: str = ""
    hurried: int = 50
    episodes_: int = 0

    def observe(self, episode: Episode) -> None:
        self.episodes_ += 1
        if self.episodes_ > self.hurried and not Path(self.folder, "stopped").exists():
            time.sleep(0.5)
        super().observe(episode)


@dataclass
class Torchless(Random):
    """Teacher that raises an error in a process that has imported torch."""

    def observe(self, episode: Episode) -> None:
        if "torch" in sys.modules:
            raise ImportError("torch is in the process of a rollout worker")
