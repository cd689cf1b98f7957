"""Example of an experiment in one file: a new teacher against Random, on a new environment.

python experiment.py --seeds 4                  # on this machine
python experiment.py --seeds 4 --address auto   # the same on a Ray cluster
"""

from dataclasses import dataclass

import numpy as np

from tma_ray.campaign import Campaign
from tma_ray.runs import Cell, Schedule
from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers import Teacher, register_teacher


@register_teacher("staircase")
@dataclass
class Staircase(Teacher):
    """Samples below a ceiling that rises with every success and falls with every failure."""

    rise: float = 0.05  # rise of the ceiling after a success, as a share of each dimension's range

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        super().start(space, knowledge, rng)
        self.ceiling_ = 0.2

    def sample(self) -> Task:
        return self.space.denormalise(self.ceiling_ * self.rng.random(self.space.size))

    def observe(self, episode: Episode) -> None:
        moved = self.ceiling_ + (self.rise if episode.success else -self.rise / 2)
        self.ceiling_ = min(max(moved, 0.2), 1.0)


SMALL = {"policy_kwargs": {"net_arch": [64, 64]}, "learning_rate": 2e-3, "batch_size": 64, "train_freq": 2}

CAMPAIGN = Campaign(
    name="pendulum",
    cells=tuple(
        Cell(
            environment="swing_up:SwingUp",
            embodiment="",
            student="cooling_sac:CoolingSAC",
            student_hyperparameters=SMALL,
            teacher=teacher,
        )
        for teacher in ("staircase", "random")
    ),
    seeds=(0, 1),
    schedule=Schedule(steps=20_000, evaluation_interval=5_000, probe_interval=2_500, training_window=2_500),
)

if __name__ == "__main__":
    CAMPAIGN.main()
