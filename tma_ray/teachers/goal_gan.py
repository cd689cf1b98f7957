"""Goal-GAN (Florensa et al. 2018)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import Array, UnitBox


@dataclass
class GoalGAN(Teacher):
    """Teacher that samples tasks of intermediate difficulty from a generative adversarial network.

    A new task is played `rollouts` times in a row and labelled positive if its share of successes is in
    [`least_success`, `most_success`]. Positive tasks far from all others enter a buffer, the source of some
    later tasks. The network is pretrained on the initial Gaussian. Its points are offsets from the centre
    in units of the ranges, which cover twice the box and are clipped (as in the original release).

    Sources: Florensa et al. 2018, algorithm 1; paper, appendix A (Goal-GAN), appendix C (expert knowledge)
    and table of hyper-parameters; batch sizes and numbers of steps from the original release, which trains
    after 100 labelled tasks instead of 100 episodes, and stores mastered instead of intermediate tasks.

    The preset "release" has the values of the original release's launch files: ten times the noise, and half
    as many tasks from the buffer. With the table's noise, which hardly leaves the pretrained tasks, training
    starves once these are mastered.

    Attributes:
        noise: standard deviation of the noise of every task, as a share of each range (paper: delta).
        train_every: episodes between two trainings of the network (paper: n).
        old_share: probability of a task from the buffer, in [0, 1] (paper: p_old).
        rollouts: episodes of a new task (paper: n_rollouts).
        least_success: smallest share of successes of an intermediate task (paper: R_min).
        most_success: largest share of successes of an intermediate task (paper: R_max).
        spacing: least root mean square distance of tasks in the buffer, in units of the ranges (paper:
            epsilon).
        iterations_per_task: steps of both networks in a training, per newly labelled task.
        pretraining_iterations: steps of both networks before the first episode.
        pretraining_tasks: tasks of the initial Gaussian for pretraining.
        batch_size: number of tasks, and of generated tasks, per step.
        learning_rate: learning rate of both optimisers.
    """

    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"release": {"noise": 0.1, "old_share": 0.1}}

    noise: float = 0.01
    train_every: int = 100
    old_share: float = 0.2
    rollouts: int = 2
    least_success: float = 0.25
    most_success: float = 0.75
    spacing: float = 0.1
    iterations_per_task: float = 2.5
    pretraining_iterations: int = 500
    pretraining_tasks: int = 1000
    batch_size: int = 64
    learning_rate: float = 1e-3

    def __post_init__(self) -> None:
        check_at_least(self, 1, "train_every", "rollouts", "pretraining_tasks", "batch_size")
        check_at_least(self, 0, "noise", "spacing", "pretraining_iterations")
        check_shares(self, "old_share")
        if not 0 <= self.least_success <= self.most_success <= 1:
            raise ValueError(
                f"least_success = {self.least_success} and most_success = {self.most_success} bound a share "
                f"of successes; expected 0 <= least <= most <= 1"
            )
        check_positive(self, "iterations_per_task", "learning_rate")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Pretrain the network on tasks of the initial Gaussian."""
        from tma_ray.teachers.networks import LeastSquaresGAN  # deferred: imports torch

        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self.network_ = LeastSquaresGAN(self._box.size, self.learning_rate, self.batch_size, rng)
        self.buffer_ = np.empty((0, self._box.size))
        self.labelled_: list[tuple[Array, bool]] = []
        self.task_ = space.low
        self.new_ = False
        self.rollouts_left_ = self.successes_ = self.episodes_ = 0
        if self.pretraining_iterations:
            tasks = self._box.normalise(knowledge.initial.sample(space, rng, self.pretraining_tasks))
            positive = np.ones(len(tasks), dtype=bool)
            losses = self.network_.train(tasks - 0.5, positive, self.pretraining_iterations, rng)
            self.log(TeacherUpdate(scalars={**losses, "buffer_size": 0.0}))

    def sample(self) -> Task:
        """Return the current task (d,) while it has rollouts left, else one from the buffer or network."""
        if not self.rollouts_left_:
            self.new_ = not (len(self.buffer_) and self.rng.random() < self.old_share)
            point = self._generate(1, self.rng)[0] if self.new_ else self.rng.choice(self.buffer_)
            self.task_ = self._box.denormalise(point + self.noise * self.rng.standard_normal(len(point)))
            self.rollouts_left_, self.successes_ = (self.rollouts if self.new_ else 1), 0
        return self.task_.copy()

    def observe(self, episode: Episode) -> None:
        """Record the outcome, label the task after its last rollout, and train the network when due."""
        self.rollouts_left_ -= 1
        self.successes_ += episode.success
        if self.new_ and not self.rollouts_left_:
            point, success = self._box.normalise(episode.task), self.successes_ / self.rollouts
            positive = self.least_success <= success <= self.most_success
            self.labelled_.append((point, positive))
            nearest = np.sqrt(((self.buffer_ - point) ** 2).mean(axis=1)).min(initial=np.inf)
            if positive and nearest > self.spacing:
                self.buffer_ = np.vstack([self.buffer_, point])
        self.episodes_ += 1
        if self.episodes_ % self.train_every == 0 and self.labelled_:
            self._train()

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) from the network, without noise."""
        return self._box.denormalise(self._generate(count, self.probe_rng()))

    def _generate(self, count: int, rng: np.random.Generator) -> Array:
        return self.network_.generate(count, rng) + 0.5

    def _train(self) -> None:
        """Train the network on the newly labelled tasks, if any is positive."""
        points = np.stack([point for point, _ in self.labelled_])
        positive = np.array([label for _, label in self.labelled_])
        scalars = {"wanted_share": float(positive.mean()), "buffer_size": float(len(self.buffer_))}
        if positive.any():
            iterations = math.ceil(self.iterations_per_task * len(points))
            scalars |= self.network_.train(points - 0.5, positive, iterations, self.rng)
        self.labelled_ = []
        self.log(TeacherUpdate(scalars=scalars))
