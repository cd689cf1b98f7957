"""The base of the teachers that replay tasks of high regret."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    Proposal,
    Query,
    QueryKind,
    Task,
    TaskSpace,
    TeacherUpdate,
    Trajectory,
)
from tma_ray.teachers.base import PAPER_STEPS, Teacher, for_budget
from tma_ray.teachers.numerics.task_cloud import cloud_gaussian
from tma_ray.teachers.replay.scores import Score, positive_value_loss
from tma_ray.teachers.replay.task_buffer import TaskBuffer

LOG_EVERY = 100
"""Episodes between two log rows."""


@dataclass
class PrioritisedReplay(Teacher):
    """Plays new tasks, keeps those of highest score in a buffer, and replays these.

    Sources: Jiang et al. 2021a (prioritised level replay) and 2021b (replay-guided adversarial environment
    design). Defaults are those of the authors' runs on a walker whose world has continuous parameters
    (Parker-Holder et al. 2022, BipedalWalker). There a level is a fixed world; here the world of a task is
    drawn anew at each replay.

    Attributes:
        replay_share: highest chance of a replay instead of a new task, in [0, 1]; it is the filled share of
            the buffer while that is less (paper: p).
        fill_first: filled share of the buffer before the first replay, in [0, 1] (authors' code: rho).
        buffer_size: most tasks kept (paper: K).
        score: estimate of a task's regret.
        temperature: of the ranks; the lower, the more often the highest scores are replayed (paper: beta).
        staleness_share: weight of staleness against score, in [0, 1] (paper: rho).
        gae_lambda: lambda of the advantage estimates in the positive value loss.
        budget: environment steps of the run, to which `for_budget` fits the buffer.
    """

    wants_trajectory: ClassVar[bool] = True
    absent_at_default: ClassVar[frozenset[str]] = frozenset(("budget",))
    new_tasks_train: ClassVar[bool] = True
    """Whether the student learns from tasks that are not replayed."""

    replay_share: float = 0.5
    fill_first: float = 0.5
    buffer_size: int = 1000
    score: Score = Score.POSITIVE_VALUE_LOSS
    temperature: float = 0.1
    staleness_share: float = 0.5
    gae_lambda: float = 0.9
    budget: int = PAPER_STEPS

    def __post_init__(self) -> None:
        for name in ("replay_share", "fill_first", "staleness_share", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} = {getattr(self, name)} is a share; expected it in [0, 1]")
        if self.buffer_size < 1:
            raise ValueError(f"buffer_size = {self.buffer_size}: expected at least 1 task")
        if not self.temperature > 0:
            raise ValueError(f"temperature = {self.temperature}: expected a number over 0")
        for_budget(self.buffer_size, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Starts with an empty buffer."""
        super().start(space, knowledge, rng)
        size = for_budget(self.buffer_size, self.budget)
        self.buffer_ = TaskBuffer(space.size, size, self.temperature, self.staleness_share)
        self.replayed_: int | None = (
            None  # place of the task that is played, None for one that is not kept yet
        )
        self.episode_: Episode | None = None
        self.trajectory_: Trajectory | None = None
        self.episodes_ = 0

    def sample(self) -> Task | Proposal:
        """Returns a task (d,) of the buffer to train on, or a new one."""
        self.replayed_ = None
        if self._replays():
            self.replayed_ = int(self.buffer_.draw(self.rng, 1)[0])
            return self.buffer_.replay(self.replayed_)
        task = self.new_tasks(self.rng)
        return task if self.new_tasks_train else Proposal(task, trains=False)

    def new_tasks(self, rng: np.random.Generator, count: int | None = None) -> Task:
        """Returns a task (d,) that is not of the buffer, or `count` of them (count, d): uniform ones."""
        return self.space.sample(rng, count)

    def observe(self, episode: Episode) -> Query:
        """Asks for what the score is made of."""
        self.episode_, self.episodes_ = episode, self.episodes_ + 1
        if self.score is Score.MAX_MC:
            return Query(QueryKind.STATE_VALUES, episode.initial_observation[None])
        return Query(QueryKind.TRAJECTORY)

    def answer(self, answer: Trajectory | NDArray[np.float64]) -> Query | None:
        """Takes the trajectory, then the values of its states; scores the task with them."""
        if isinstance(answer, Trajectory):
            self.trajectory_ = answer
            return Query(QueryKind.STATE_VALUES, answer.observations)
        assert self.episode_ is not None, "an answer follows an episode"
        self._count_in(self.episode_, answer)
        self.episode_ = self.trajectory_ = None
        return None

    def probe(self, count: int) -> Task:
        """Returns `count` tasks (count, d) as they are replayed; new ones while the buffer is empty."""
        rng = self.probe_rng()
        if not len(self.buffer_):
            return self.new_tasks(rng, count)
        tasks: Task = self.buffer_.tasks[self.buffer_.draw(rng, count)]
        return tasks

    def after_replay(self, task: Task) -> None:
        """Hears that `task` (d,) of the buffer was played and scored."""

    def _replays(self) -> bool:
        filled = self.buffer_.filled
        return filled >= self.fill_first and self.rng.random() < min(filled, self.replay_share)

    def _count_in(self, episode: Episode, values: NDArray[np.float64]) -> None:
        best, place = episode.discounted_return, self.replayed_
        if place is not None:
            best = max(best, float(self.buffer_.best[place]))
        if self.trajectory_ is None:
            score = best - float(values[0])
        else:
            score = positive_value_loss(self.trajectory_, values, self.gae_lambda)
        if place is None:
            self.buffer_.offer(episode.task, score, best)
        else:
            self.buffer_.rescore(place, score, best)
            self.after_replay(episode.task)
        if self.episodes_ % LOG_EVERY == 0:
            self._log()

    def _log(self) -> None:
        """Logs the Gaussian that replays resemble."""
        chances = self.buffer_.chances()
        scalars = {
            "buffer_size": float(len(self.buffer_)),
            "mean_score": float(self.buffer_.scores.mean()),
            "replayed_score": float(chances @ self.buffer_.scores),
        }
        gaussian = cloud_gaussian(self.space, self.buffer_.tasks, chances)
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars=scalars))
