"""Time of runs that share learners: bound by the learners, or by the cores of their players."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tma_ray.campaign.settings import Nodes, Settings


@dataclass(frozen=True)
class Sharing:
    """Use of nodes by cohorts.

    Attributes:
        width: slots of each.
        learners: cohorts that the nodes hold and the runs need: one with each GPU, or as many as there are
            cores for.
        gpus: of each learner.
        cores: number of cores that are left for players beside them.
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
    def of(
        cls, settings: Settings, nodes: Nodes, runs: int, learner_hours: float, player_hours: float
    ) -> Sharing:
        """Returns the use that so many runs make of `nodes`."""
        gpus, player = float(settings.device != "cpu"), settings.player.cpus
        learners, left = 0, 0.0
        for node in nodes.resources:
            cores = node.get("CPU", 0.0)
            full = max(1, int(cores / (1 + settings.width * player)))
            here = int(node.get("GPU", 0.0)) if gpus else full
            if here and cores:
                learners, left = learners + here, left + max(player, cores - here)
        used = min(max(1, learners), math.ceil(runs / settings.width))
        cores = max(player, left * used / max(1, learners))
        return cls(settings.width, used, gpus, cores, learner_hours, player_hours)

    @property
    def hours(self) -> float:
        """Time on these nodes, h."""
        return max(self.learner_hours / self.learners, self.player_hours / self.cores)

    @property
    def core_hours(self) -> float:
        """Time of their cores, learners' included, h."""
        return self.player_hours + self.hours * self.learners

    @property
    def gpu_hours(self) -> float:
        """Time of their GPUs, h."""
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
