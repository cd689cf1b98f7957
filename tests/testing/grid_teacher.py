"""A teacher on a grid over all dimensions, as one first writes it: it has limits, and declares none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tma_ray.teachers import Teacher


@dataclass
class Grid(Teacher):
    """Prefers squares of a grid in which returns changed last.

    Args:
        bins: squares of each dimension.
    """

    bins: int = 6

    def start(self, space: Any, knowledge: Any, rng: np.random.Generator) -> None:
        super().start(space, knowledge, rng)
        self.change_ = np.ones((self.bins,) * space.size)
        self.last_ = np.zeros_like(self.change_)

    def sample(self) -> np.ndarray:
        shares = self.change_.ravel() / self.change_.sum()
        square = np.unravel_index(self.rng.choice(shares.size, p=shares), self.change_.shape)
        low = np.array(square) + self.rng.random(self.space.size)
        return self.space.clip(self.space.low + low / self.bins * self.space.width)

    def observe(self, episode: Any) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):  # the limit that it has, and does not declare
            shares = (episode.task - self.space.low) / self.space.width
            square = tuple(np.minimum(shares * self.bins, self.bins - 1).astype(int))
        self.change_[square] = 1 + abs(episode.episodic_return - self.last_[square])
        self.last_[square] = episode.episodic_return

    def probe(self, n: int) -> np.ndarray:
        return self.space.sample(self.probe_rng(), n)


@dataclass
class FreeGrid(Grid):
    """The same, declared to need free dimensions."""

    constant_dimensions: ClassVar[bool] = False


@dataclass
class SmallGrid(FreeGrid):
    """The same with all limits that it has."""

    most_dimensions: ClassVar[int | None] = 3
