"""The tasks that a student has mastered, kept where the target distribution is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tma_ray.teachers.numerics.transport import assigned

Array = NDArray[np.float64]

WIDEST_NOISE = 0.25
"""Standard deviation of the noise around the worst task, as a share of each range."""


@dataclass
class SuccessBuffer:
    """At most `capacity` tasks of high return, after the authors' code of CURROT.

    Until their median reaches `least`, tasks of at least the median return push out the worst half. Then
    tasks that reach it replace those that do not, and where all do and the buffer is full, those stay that an
    optimal assignment to the target distribution needs.

    Attributes:
        size: number f of coordinates.
        capacity: most tasks.
        least: return of a success.
        points: coordinates of the tasks in [0, 1] (n, f).
        returns: of an episode of each (n,).
        reached: whether the median has reached `least`.
        worst: lowest return of the first tasks.
    """

    size: int
    capacity: int
    least: float
    points: Array = field(init=False)
    returns: Array = field(init=False)
    reached: bool = field(init=False, default=False)
    worst: float = field(init=False, default=np.inf)

    def __post_init__(self) -> None:
        self.points, self.returns = np.empty((0, self.size)), np.empty(0)

    def add(self, points: Array, returns: Array, targets: Array) -> NDArray[np.bool_]:
        """Takes over what belongs here of new tasks (k, f), returns (k,); returns which were left out (k,).

        Args:
            points: coordinates of the tasks.
            returns: of an episode of each.
            targets: draws of the target distribution (`capacity`, f).
        """
        if not len(self.returns):
            self.worst = float(returns.min())
        wanted = returns >= (self.least if self.reached else self._median)
        kept = self._kept_of_old(int(wanted.sum()))
        everything = np.concatenate([points[wanted], self.points[kept]])
        all_returns = np.concatenate([returns[wanted], self.returns[kept]])
        chosen = self._chosen(everything, all_returns, targets)
        self.points, self.returns = everything[chosen], all_returns[chosen]
        left_out = ~wanted
        left_out[wanted] = ~np.isin(np.arange(wanted.sum()), chosen)
        self.reached = self.reached or self._median >= self.least
        return left_out

    def draw(self, rng: np.random.Generator, count: int, narrowest: float) -> Array:
        """Returns `count` points (count, f) around the tasks, farther off the less they return.

        Args:
            rng: draws them.
            count: how many.
            narrowest: standard deviation of the noise around successes, as a share of each range.
        """
        below = np.maximum(self.least - self.returns, 0.0) / max(self.least - self.worst, 1e-9)
        deviations = narrowest + WIDEST_NOISE * np.minimum(below, 1.0)
        if self.reached:
            places = np.arange(count) % len(self.returns)
        else:
            merits = np.maximum(self.returns - self._median, 0.0)
            merits = merits if merits.sum() > 0 else np.ones(len(self.returns))
            places = rng.choice(len(self.returns), count, p=merits / merits.sum())
        noise = deviations[places, None] * rng.standard_normal((count, self.size))
        return np.clip(self.points[places] + noise, 0.0, 1.0)

    @property
    def _median(self) -> float:
        return float(np.median(self.returns)) if len(self.returns) else -np.inf

    def _kept_of_old(self, new: int) -> NDArray[np.int64]:
        """Returns the places of the tasks that stay while `new` ones come, of those that may go the best."""
        may_go = int((self.returns < self.least).sum()) if self.reached else len(self.returns) // 2 + 1
        order = np.argsort(self.returns, kind="stable")
        return np.sort(order[min(new, may_go) :])

    def _chosen(self, points: Array, returns: Array, targets: Array) -> NDArray[np.int64]:
        """Returns the places of at most `capacity` tasks."""
        if len(returns) <= self.capacity:
            return np.arange(len(returns))
        if self.reached and returns.min() >= self.least:
            return np.sort(assigned(targets[: self.capacity], points))
        return np.sort(np.argsort(-returns, kind="stable")[: self.capacity])
