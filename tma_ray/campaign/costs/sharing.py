"""Time of runs that share learners: bound by the learners, or by the cores of their players."""

from __future__ import annotations

import os
from dataclasses import dataclass

from tma_ray.campaign.settings import Settings


@dataclass(frozen=True)
class Sharing:
    """Use of one machine by cohorts.

    Attributes:
        width: slots of each.
        learners: cohorts that this machine holds: one with one GPU, or as many as there are cores for.
        gpus: of each learner.
        cores: of this machine that are left for players.
        learner_hours: of all runs, one learner with full slots for all.
        player_hours: of all runs, one core for all.
    """

    width: int
    learners: int
    gpus: float
    cores: float
    learner_hours: float
    player_hours: float

    @classmethod
    def of(cls, settings: Settings, learner_hours: float, player_hours: float) -> Sharing:
        """Returns the use of this machine."""
        cores, gpus = float(os.cpu_count() or 1), float(settings.device != "cpu")
        full = 1 + settings.width * settings.player.cpus
        learners = 1 if gpus else max(1, int(cores / full))
        left = max(settings.player.cpus, cores - learners)
        return cls(settings.width, learners, gpus, left, learner_hours, player_hours)

    @property
    def hours(self) -> float:
        """Time on this machine, h."""
        return max(self.learner_hours / self.learners, self.player_hours / self.cores)

    @property
    def core_hours(self) -> float:
        """Time of its cores, learners' included, h."""
        return self.player_hours + self.hours * self.learners

    @property
    def gpu_hours(self) -> float:
        """Time of its GPU, h."""
        return self.hours * self.learners * self.gpus

    @property
    def bound_by(self) -> str:
        """Part that decides the time."""
        by_learner = self.learner_hours / self.learners >= self.player_hours / self.cores
        return "learner" if by_learner else "players' cores"

    @property
    def bound(self) -> str:
        """Part that decides the time, and how much of it the other part is at work."""
        share = self.learner_hours / self.learners, self.player_hours / self.cores
        slower = self.bound_by
        faster = "learner" if slower != "learner" else "players' cores"
        return f"bound by the {slower}; the {faster} would take {min(share) / max(share):.0%} of that time"
