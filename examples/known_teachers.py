"""Teachers of releases under other names, to learn what a trial says of them: no more than there is."""

from dataclasses import dataclass

from tma_ray.teachers.goal_gan import GoalGAN
from tma_ray.teachers.random import Random


@dataclass
class AnotherRandom(Random):
    """Random under another name: no trial must find it better than Random."""

    algorithm_version = None


@dataclass
class AnotherGoalGAN(GoalGAN):
    """GoalGAN under another name, and so with other random numbers: as good as the one released."""

    algorithm_version = None
