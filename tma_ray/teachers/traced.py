"""TRACED: ACCEL with transition errors and co-learnability in its scores (Cho et al. 2025)."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, TaskSpace, Trajectory
from tma_ray.teachers.accel import ACCEL
from tma_ray.teachers.numerics import Array, one_thread
from tma_ray.teachers.prioritised_replay import Score

RIDGE = 1.0  # weight, in steps, of the prior that observations do not change


@dataclass
class TransitionModel:
    """Online ridge regression of changes in observations on observations and actions."""

    memory: float  # discount factor of earlier episodes, in (0, 1]
    steps: float = 0.0  # weighted number of steps
    # second moments of the inputs (p, p); None before the first episode
    gram: Array | None = field(init=False, default=None)
    moments: Array | None = field(init=False, default=None)  # products of inputs and changes (p, o)
    squares: Array | None = field(init=False, default=None)  # sums of squared changes (o,)

    def error(self, trajectory: Trajectory) -> float:
        """Learn from an episode, and return its mean squared prediction error before learning.

        Errors are relative to the mean squared change of each value of the observation, including this
        episode: predicting no change has an error of about 1, and a constant value has 0.
        """
        observations = trajectory.observations.astype(np.float64)
        constant = np.ones((len(trajectory.rewards), 1))
        inputs = np.hstack([constant, observations[:-1], trajectory.actions])
        changes = np.diff(observations, axis=0)
        with one_thread():
            errors = (changes - self.predict(inputs)) ** 2
            gram, moments, squares = inputs.T @ inputs, inputs.T @ changes, (changes**2).sum(axis=0)
            if self.gram is not None and self.moments is not None and self.squares is not None:
                gram += self.memory * self.gram
                moments += self.memory * self.moments
                squares += self.memory * self.squares
            self.steps = len(inputs) + self.memory * self.steps
            self.gram, self.moments, self.squares = gram, moments, squares
        scale = self.squares / self.steps
        shares = np.divide(errors.mean(axis=0), scale, out=np.zeros_like(scale), where=scale > 0)
        return float(shares.mean())

    def predict(self, inputs: Array) -> Array | float:
        """Predict the changes (t, o) for `inputs` (t, p); zeros before the first episode."""
        if self.gram is None or self.moments is None:
            return 0.0
        weights = np.linalg.solve(self.gram + RIDGE * np.eye(len(self.gram)), self.moments)
        return np.asarray(inputs @ weights, dtype=np.float64)


@dataclass
class TRACED(ACCEL):
    """ACCEL whose score adds the error of a transition model and the task's co-learnability.

    The difficulty of a task is its positive value loss plus alpha times the mean transition error of its
    episode under a model learned online. The co-learnability of the tasks replayed in round k is the mean
    decrease of difficulty of those replayed in round k + 1. Tasks are replayed by the rank of difficulty plus
    beta times co-learnability, with probabilities in proportion to 1 / rank.

    Sources: Cho et al. 2025 (arXiv:2506.19997) for difficulty, co-learnability and priority, read in others'
    restatements, not in the authors' code. The transition model (theirs is a recurrent network), the scale of
    its errors, alpha and beta are our choice.

    Attributes:
        error_weight: weight of the transition error (paper: alpha).
        co_learnability_weight: weight of co-learnability (paper: beta).
        round_size: replays of a round (paper: 4 workers on BipedalWalker).
        memory: forgetting factor of the transition model per episode, in (0, 1].
    """

    algorithm_version: ClassVar[int | None] = 1

    temperature: float = 1.0
    error_weight: float = 1.0
    co_learnability_weight: float = 1.0
    round_size: int = 4
    memory: float = 0.99

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.score is not Score.POSITIVE_VALUE_LOSS:
            raise ValueError(
                f"score = {self.score}: expected positive_value_loss, to which TRACED adds its own terms"
            )
        check_at_least(self, 0, "error_weight", "co_learnability_weight")
        check_at_least(self, 1, "round_size")
        check_positive(self, "memory")
        check_shares(self, "memory")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty buffer and an untrained model."""
        super().start(space, knowledge, rng)
        self.transitions_ = TransitionModel(self.memory)
        self.difficulties_ = np.zeros(self.buffer_.capacity)
        self.co_learnability_ = np.zeros(self.buffer_.capacity)
        self.previous_round_: list[int] = []
        self.round_: list[int] = []
        self.drops_: list[float] = []

    def estimate(self, trajectory: Trajectory, values: Array, best: float, mastered: bool) -> float:
        """Return the difficulty of a task; takes the same arguments as `PrioritisedReplay.estimate`."""
        loss = super().estimate(trajectory, values, best, mastered)
        return loss + self.error_weight * self.transitions_.error(trajectory)

    def count_in(self, episode: Episode, values: Array) -> int | None:
        """Score the task of `episode` by state `values`; return the buffer slot, or None if not stored."""
        replayed = self.replayed_ is not None
        slot = super().count_in(episode, values)
        if slot is None:
            return None
        before, self.difficulties_[slot] = self.difficulties_[slot], self.buffer_.scores[slot]
        if replayed:
            self._set_priority(slot)
            self.round_.append(slot)
            self.drops_.append(float(before - self.difficulties_[slot]))
            if len(self.drops_) == self.round_size:
                for previous in self.previous_round_:
                    self.co_learnability_[previous] = np.mean(self.drops_)
                    self._set_priority(previous)
                self.previous_round_, self.round_, self.drops_ = self.round_, [], []
        else:
            self._forget(slot)
        return slot

    def _forget(self, slot: int) -> None:
        """Discard the co-learnability of the previous task in `slot`."""
        self.co_learnability_[slot] = 0.0
        self.previous_round_ = [previous for previous in self.previous_round_ if previous != slot]
        self.round_ = [replayed for replayed in self.round_ if replayed != slot]

    def _set_priority(self, slot: int) -> None:
        gain = self.co_learnability_weight * self.co_learnability_[slot]
        self.buffer_.scores[slot] = self.difficulties_[slot] + gain
