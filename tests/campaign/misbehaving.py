"""Teachers that do what they should not; named as ``misbehaving:Name``."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from tma_ray.tasks import Episode, Task
from tma_ray.teachers.random import Random
from tma_ray.teachers.riac import RIAC


@dataclass
class Raising(Random):
    """Raises after some episodes."""

    def sample(self) -> Task:
        raise ZeroDivisionError("a teacher's own mistake")


@dataclass
class Dying(Random):
    """Kills its process at its 40th episode, but only once: a marker file says that it has."""

    marker: str = ""
    episodes_: int = 0

    def observe(self, episode: Episode) -> None:
        self.episodes_ += 1
        if self.episodes_ == 40 and not Path(self.marker).exists():
            Path(self.marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)


@dataclass
class Waiting(Random):
    """Raises until a file is there: whatever was missing has been mended."""

    needed: str = ""

    def sample(self) -> Task:
        if not Path(self.needed).exists():
            raise FileNotFoundError(f"{self.needed} is missing")
        return super().sample()


@dataclass
class Lingering(RIAC):
    """Its run cannot end before a file is there: after some episodes each takes half a second until then."""

    awaited: str = ""
    hurried: int = 50
    episodes_: int = 0

    def observe(self, episode: Episode) -> None:
        self.episodes_ += 1
        if self.episodes_ > self.hurried and not Path(self.awaited).exists():
            time.sleep(0.5)
        super().observe(episode)
