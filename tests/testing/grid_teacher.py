"""Naive teacher on a grid over all dimensions, with and without a declaration of its limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tma_ray.teachers import Teacher


@dataclass
class Grid(Teacher):
    """Prefers grid cells with large changes of the return.

    Args:
        bins: cells along each dimension.
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
        with np.errstate(divide="ignore", invalid="ignore"):  # constant dimensions divide by 0
            shares = (episode.task - self.space.low) / self.space.width
            square = tuple(np.minimum(shares * self.bins, self.bins - 1).astype(int))
        self.change_[square] = 1 + abs(episode.episodic_return - self.last_[square])
        self.last_[square] = episode.episodic_return

    def probe(self, n: int) -> np.ndarray:
        return self.space.sample(self.probe_rng(), n)


@dataclass
class FreeGrid(Grid):
    """Grid teacher that declares to need varying dimensions."""

    constant_dimensions: ClassVar[bool] = False


@dataclass
class SmallGrid(FreeGrid):
    """Grid teacher that declares all of its limits."""

    most_dimensions: ClassVar[int | None] = 3
