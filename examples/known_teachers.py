"""Known teachers under other names, to check the verdicts of trials on them."""

from dataclasses import dataclass

from tma_ray.teachers.goal_gan import GoalGAN
from tma_ray.teachers.random import Random


@dataclass
class AnotherRandom(Random):
    """Random under another name, which no trial should find better than Random."""

    algorithm_version = None


@dataclass
class AnotherGoalGAN(GoalGAN):
    """GoalGAN under another name, and so with other random numbers."""

    algorithm_version = None
