"""Base class of teachers that replay tasks of high regret."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.validation import check_at_least, check_positive, check_shares
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
from tma_ray.teachers.base import PAPER_BUDGET, Teacher, for_budget
from tma_ray.teachers.numerics import Array, cloud_gaussian


class Score(StrEnum):
    """Estimators of a task's regret from an episode (Jiang et al. 2021b, section 4.1 and appendix).

    If values include entropy bonuses (SAC), rewards do, too.
    """

    POSITIVE_VALUE_LOSS = "positive_value_loss"
    """Mean of the generalised advantage estimates, clipped at 0, over the steps."""

    MAX_MC = "max_mc"
    """Highest discounted return of the task so far minus the value of its first state."""

    MNA = "mna"
    """Maximised negative advantage of a task that was mastered at least once, else 0 (Mead et al. 2026)."""


def positive_value_loss(trajectory: Trajectory, values: Array, gae_lambda: float) -> float:
    """Return the positive value loss of an episode of t steps.

    Args:
        trajectory: trajectory of the episode.
        values: values of its observations (t + 1,); the last one does not count after termination.
        gae_lambda: lambda of the estimates (arXiv:1506.02438).
    """
    from scipy.signal import lfilter  # deferred, so that listing teachers does not import scipy

    errors = value_errors(trajectory, values)
    advantages = lfilter([1.0], [1.0, -trajectory.gamma * gae_lambda], errors[::-1])
    return float(np.maximum(advantages, 0.0).mean())


NEGLIGIBLE_WEIGHT = 1e-9  # n-step advantages of smaller weight are left out of the average


def negative_advantage(trajectory: Trajectory, values: Array, gae_lambda: float) -> float:
    """Return the maximised negative advantage of an episode of t steps, at least 0.

    The advantage of n steps from state i is the sum of gamma^k errors[i + k] over k < n. Partial sums are
    clipped at 0, which compares with the highest value so far. Sums of all lengths are averaged with the
    weights of lambda, and then over the states, and negated. Arguments are those of `positive_value_loss`.

    Sources: the authors' code (``compute_clipped_gae`` of ``minigrid/maze_plr.py``), with the mean over the
    steps of its README's table of metrics instead of the code's sum.
    """
    errors = value_errors(trajectory, values)
    sums, total = np.zeros(len(errors)), 0.0
    for length in range(len(errors)):
        weight = gae_lambda**length
        if weight < NEGLIGIBLE_WEIGHT:
            break
        before = sums[: len(errors) - length]
        longer = np.minimum(before + trajectory.gamma**length * errors[length:], 0.0)
        # averages n-step sums with the weights (1 - lambda) lambda^(n - 1); the longest sum of each state has
        # the remaining weight
        total += weight * float((longer - before).sum())
        sums[: len(longer)] = longer
    return -total / len(errors)


def value_errors(trajectory: Trajectory, values: Array) -> Array:
    """Return the temporal-difference errors (t,) of `values` (t + 1,)."""
    following = values[1:].copy()
    if trajectory.terminated:
        following[-1] = 0.0
    errors: Array = trajectory.rewards + trajectory.gamma * following - values[:-1]
    if trajectory.entropy_bonuses is not None:
        errors += trajectory.entropy_bonuses
    return errors


@dataclass
class TaskBuffer:
    """Buffer of at most `capacity` tasks and their replay probabilities.

    Task i is replayed with the probability (1 - rho) P_S(i) + rho P_C(i), where P_S is proportional to
    (1 / rank of its score) ** (1 / temperature), and P_C to the replays since it was played (Jiang et al.
    2021a, section 3). A new task of at least its score replaces the task of lowest probability.
    """

    size: int  # number d of dimensions of a task
    capacity: int  # largest number of tasks
    temperature: float  # beta in the paper
    staleness_share: float  # rho in the paper, in [0, 1]
    tasks: Task = field(init=False)  # tasks in the buffer (k, d)
    scores: Array = field(init=False)  # scores of the tasks (k,)
    staleness: Array = field(init=False)  # number of replays since each task was last played (k,)
    best: Array = field(init=False)  # highest discounted return of each task so far (k,)
    mastered: NDArray[np.bool_] = field(init=False)  # True for tasks mastered at least once (k,)

    def __post_init__(self) -> None:
        self.tasks = np.empty((0, self.size), dtype=np.float32)
        self.scores, self.staleness, self.best = np.empty(0), np.empty(0), np.empty(0)
        self.mastered = np.empty(0, dtype=np.bool_)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a buffer; in older checkpoints, without the field `mastered`, no task is mastered."""
        vars(self).update({"mastered": np.zeros(len(state["tasks"]), dtype=np.bool_)} | state)

    def __len__(self) -> int:
        return len(self.tasks)

    @property
    def filled(self) -> float:
        """Fraction of the capacity in use."""
        return len(self) / self.capacity

    def chances(self) -> Array:
        """Return the replay probabilities (k,) of the tasks."""
        ranks = np.empty(len(self))
        ranks[np.argsort(-self.scores, kind="stable")] = np.arange(1, len(self) + 1)
        by_score = ranks ** (-1 / self.temperature)
        stale = self.staleness if self.staleness.any() else np.ones(len(self))
        shares = np.array([1 - self.staleness_share, self.staleness_share])
        chances: Array = shares @ np.stack([by_score / by_score.sum(), stale / stale.sum()])
        return chances

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Draw the indices (count,) of tasks to replay, leaving staleness unchanged."""
        cumulative = np.cumsum(self.chances())
        slots: NDArray[np.int64] = np.searchsorted(
            cumulative, rng.random(count) * cumulative[-1], side="right"
        )
        return slots

    def replay(self, slot: int) -> Task:
        """Return the task (d,) in `slot`; reset its staleness, and increase that of all other tasks."""
        self.staleness += 1
        self.staleness[slot] = 0
        task: Task = self.tasks[slot].copy()
        return task

    def rescore(self, slot: int, score: float, best: float, mastered: bool = False) -> None:
        """Set the score, best return and mastery of the task in `slot` after an episode."""
        self.scores[slot], self.best[slot], self.mastered[slot] = score, best, mastered

    def offer(self, task: Task, score: float, best: float, mastered: bool = False) -> int | None:
        """Add `task` (d,) and return its slot, or return None if the task to replace scores higher."""
        if len(self) < self.capacity:
            self.tasks = np.vstack([self.tasks, task])
            added = (self.scores, score), (self.staleness, 0.0), (self.best, best)
            self.scores, self.staleness, self.best = (np.append(column, value) for column, value in added)
            self.mastered = np.append(self.mastered, mastered)
            return len(self) - 1
        slot = int(self.chances().argmin())
        if self.scores[slot] > score:
            return None
        self.tasks[slot], self.staleness[slot] = task, 0.0
        self.rescore(slot, score, best, mastered)
        return slot


LOG_EVERY = 100  # number of episodes between two log rows


@dataclass
class PrioritisedReplay(Teacher):
    """Teacher that plays new tasks, and replays high-scoring ones from a buffer.

    Sources: Jiang et al. 2021a (prioritised level replay) and 2021b (replay-guided adversarial environment
    design). Defaults are those of the authors' runs on a walker with continuous parameters (Parker-Holder et
    al. 2022, BipedalWalker). There a level is a fixed world; here each replay draws a new world of the task.

    Attributes:
        replay_share: highest probability of a replay instead of a new task, in [0, 1], which is bounded by
            the filled share of the buffer (paper: p).
        fill_first: filled share of the buffer before the first replay, in [0, 1] (authors' code: rho).
        buffer_size: largest number of tasks in the buffer (paper: K).
        score: estimate of a task's regret.
        temperature: temperature of the ranks; low values favour the highest scores (paper: beta).
        staleness_share: weight of staleness against score, in [0, 1] (paper: rho).
        gae_lambda: lambda of the advantage estimates in the positive value loss.
        budget: environment steps of the run, to which `for_budget` fits the buffer.
    """

    wants_values: ClassVar[bool] = True
    overlapping: ClassVar[bool] = True
    episode_state: ClassVar[tuple[str, ...]] = ("replayed_",)
    wants_trajectory: ClassVar[bool] = True
    absent_at_default: ClassVar[frozenset[str]] = frozenset(("budget",))
    new_tasks_train: ClassVar[bool] = True
    """True if the student learns from new tasks."""

    replay_share: float = 0.5
    fill_first: float = 0.5
    buffer_size: int = 1000
    score: Score = Score.POSITIVE_VALUE_LOSS
    temperature: float = 0.1
    staleness_share: float = 0.5
    gae_lambda: float = 0.9
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_shares(self, "replay_share", "fill_first", "staleness_share", "gae_lambda")
        check_at_least(self, 1, "buffer_size")
        check_positive(self, "temperature")
        for_budget(self.buffer_size, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty buffer."""
        super().start(space, knowledge, rng)
        size = for_budget(self.buffer_size, self.budget)
        self.buffer_ = TaskBuffer(space.size, size, self.temperature, self.staleness_share)
        self.replayed_: int | None = None  # slot of the task being replayed, None for a new task
        self.episode_: Episode | None = None
        self.trajectory_: Trajectory | None = None
        self.episodes_ = 0

    def sample(self) -> Task | Proposal:
        """Return a task (d,) to replay, or a new one, as a `Proposal` if the student must not learn."""
        self.replayed_ = None
        filled = self.buffer_.filled
        if filled >= self.fill_first and self.rng.random() < min(filled, self.replay_share):
            self.replayed_ = int(self.buffer_.draw(self.rng, 1)[0])
            return self.buffer_.replay(self.replayed_)
        task = self.new_tasks(self.rng)
        return task if self.new_tasks_train else Proposal(task, trains=False)

    def new_tasks(self, rng: np.random.Generator, count: int | None = None) -> Task:
        """Return a new uniform task (d,), or `count` new tasks (count, d)."""
        return self.space.sample(rng, count)

    def observe(self, episode: Episode) -> Query:
        """Request the episode's trajectory, to score the task."""
        self.episode_, self.episodes_ = episode, self.episodes_ + 1
        if self.replayed_ is not None and (self.buffer_.tasks[self.replayed_] != episode.task).any():
            self.replayed_ = None  # the slot now has another task, added by an overlapping episode
        return Query(QueryKind.TRAJECTORY)

    def answer(self, answer: Trajectory | Array) -> Query | None:
        """Store the trajectory and request its state values, or score the task with these values."""
        if isinstance(answer, Trajectory):
            self.trajectory_ = answer
            valued = answer.observations[:1] if self.score is Score.MAX_MC else answer.observations
            return Query(QueryKind.STATE_VALUES, valued)
        assert self.episode_ is not None, "an answer follows an episode"
        self.count_in(self.episode_, answer)
        self.episode_ = self.trajectory_ = None
        return None

    def probe(self, count: int) -> Task:
        """Return `count` replayed tasks (count, d), or new ones while the buffer is empty."""
        rng = self.probe_rng()
        if not len(self.buffer_):
            return self.new_tasks(rng, count)
        tasks: Task = self.buffer_.tasks[self.buffer_.draw(rng, count)]
        return tasks

    def after_replay(self, task: Task) -> None:
        """Hook called after the replay of `task` (d,) has been scored; does nothing by default."""

    def estimate(self, trajectory: Trajectory, values: Array, best: float, mastered: bool) -> float:
        """Return the score of a task after an episode.

        Args:
            trajectory: trajectory of an episode of the task.
            values: values of its observations (t + 1,), or of the first one.
            best: highest discounted return of the task so far.
            mastered: True if the task was mastered at least once.
        """
        if self.score is Score.MAX_MC:
            return best - float(values[0])
        if self.score is Score.MNA:
            return negative_advantage(trajectory, values, self.gae_lambda) if mastered else 0.0
        return positive_value_loss(trajectory, values, self.gae_lambda)

    def count_in(self, episode: Episode, values: Array) -> int | None:
        """Score the task of `episode` by state `values`; return the buffer slot, or None if not stored."""
        best, slot, trajectory = episode.discounted_return, self.replayed_, self.trajectory_
        mastered = episode.success
        assert trajectory is not None, "its states have been valued"
        if trajectory.entropy_bonuses is not None:
            best += float(np.polynomial.polynomial.polyval(trajectory.gamma, trajectory.entropy_bonuses))
        if slot is not None:
            best = max(best, float(self.buffer_.best[slot]))
            mastered = mastered or bool(self.buffer_.mastered[slot])
        score = self.estimate(trajectory, values, best, mastered)
        if slot is None:
            slot = self.buffer_.offer(episode.task, score, best, mastered)
        else:
            self.buffer_.rescore(slot, score, best, mastered)
            self.after_replay(episode.task)
        if self.episodes_ % LOG_EVERY == 0:
            chances = self.buffer_.chances()
            scalars = {
                "buffer_size": float(len(self.buffer_)),
                "mean_score": float(self.buffer_.scores.mean()),
                "replayed_score": float(chances @ self.buffer_.scores),
            }
            gaussian = cloud_gaussian(self.space, self.buffer_.tasks, chances)
            self.log(TeacherUpdate(gaussians=(gaussian,), scalars=scalars))
        return slot
