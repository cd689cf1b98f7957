"""Tiers: the share of an experiment that is run, from some minutes of it to all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from tma_ray.benchmark.matrices import Matrix


class Tier(StrEnum):
    """Sizes of an experiment, in rising order."""

    SMOKE = "smoke"
    """Some minutes, most of them to start processes: does all of it work here?"""
    LITE = "lite"
    """A night on a laptop, with PPO: where is my teacher strong, roughly?"""
    PAPER = "paper"
    """Everything, as the paper has it."""


@dataclass(frozen=True)
class Size:
    """Changes of a tier to every experiment; None leaves that as the experiment has it.

    Attributes:
        students: who learns instead of the experiment's students.
        teachers: who teaches where neither the experiment nor the user says.
        levels: how many levels of expert knowledge are kept, from the highest down.
        seeds: how many are kept of each combination.
        points: how many are kept of a grid of hyper-parameters.
        steps: budget of a run, in environment steps.
        evaluation_interval: between evaluations, in environment steps.
        probe_interval: between probes of the curriculum, in environment steps.
        training_window: length of the windows of training statistics, in environment steps.
    """

    students: tuple[str, ...] | None = None
    teachers: tuple[str, ...] | None = None
    levels: int | None = None
    seeds: int | None = None
    points: int | None = None
    steps: int | None = None
    evaluation_interval: int | None = None
    probe_interval: int | None = None
    training_window: int | None = None

    def of(self, matrix: Matrix) -> Matrix:
        """Returns what is left of `matrix` at this size."""
        return replace(
            matrix,
            students=self.students or matrix.students,
            levels=matrix.levels[-(self.levels or len(matrix.levels)) :],
            seeds=matrix.seeds[: self.seeds],
            steps=self.steps or matrix.steps,
            most_points=self.points or matrix.most_points,
        )


SIZES: dict[Tier, Size] = {
    Tier.SMOKE: Size(
        students=("ppo",),
        teachers=("random", "alp_gmm"),
        levels=1,
        seeds=1,
        points=2,
        steps=4_000,
        evaluation_interval=4_000,
        probe_interval=2_000,
        training_window=1_000,
    ),
    Tier.LITE: Size(
        students=("ppo",),
        seeds=3,
        points=12,
        steps=2_000_000,
        evaluation_interval=250_000,
        probe_interval=100_000,
        training_window=100_000,
    ),
    Tier.PAPER: Size(),
}
"""PPO makes seventy times as many steps a second as SAC, which the paper uses nearly everywhere."""
