"""Particles on their way to a target distribution, by optimal transport under a constraint on performance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS_AT_ONCE = 2_000
"""Predictions that are made together, which bounds the memory."""


def assigned(sources: Array, targets: Array) -> NDArray[np.int64]:
    """Returns for each of n `sources` (n, f) its target in the optimal assignment of squared distances.

    Args:
        sources: n points.
        targets: at least n points (m, f).
    """
    from scipy.optimize import linear_sum_assignment  # imported here: drivers start sooner without it
    from scipy.spatial.distance import cdist

    rows, columns = linear_sum_assignment(cdist(sources, targets, "sqeuclidean"))
    assert len(rows) == len(sources), "there are as many targets as sources"
    places: NDArray[np.int64] = columns
    return places


class Performance(NamedTuple):
    """Returns expected at points: averages of known ones, weighted by a Gaussian kernel (Nadaraya-Watson).

    Attributes:
        points: where returns are known (n, f).
        returns: (n,).
        width: standard deviation of the kernel.
    """

    points: Array
    returns: Array
    width: float

    def __call__(self, points: Array) -> Array:
        """Returns the expectations (k,) at `points` (k, f)."""
        from scipy.spatial.distance import cdist

        results = []
        for first in range(0, len(points), ROWS_AT_ONCE):
            squares = cdist(points[first : first + ROWS_AT_ONCE], self.points, "sqeuclidean")
            exponents = (squares.min(axis=1, keepdims=True) - squares) / (2 * self.width**2)
            weights = np.exp(exponents.astype(np.float32))
            results.append((weights @ self.returns.astype(np.float32)) / weights.sum(axis=1))
        return np.concatenate(results).astype(np.float64)


class Region(NamedTuple):
    """The reach of a particle in one move.

    Attributes:
        radius: of the ball around it.
        candidates: points tried in the ball.
        line_candidates: points tried on the way to its target.
    """

    radius: float
    candidates: int
    line_candidates: int


def moved(
    particles: Array,
    targets: Array,
    performance: Performance,
    least: float,
    region: Region,
    rng: np.random.Generator,
) -> Array:
    """Returns `particles` (n, f) of the unit box, each as near to its target as performance allows.

    Args:
        particles: where they are.
        targets: of each (n, f).
        performance: returns to expect.
        least: return to expect at least; where no point of the region has it, the best one is taken.
        region: what is tried; towards the target only, of particles that have the least return.
        rng: draws the candidates.
    """
    candidates = _candidates(particles, targets, performance(particles) >= least, region, rng)
    count, tried, size = candidates.shape
    expected = performance(candidates.reshape(-1, size)).reshape(count, tried)
    distances = np.linalg.norm(candidates - targets[:, None], axis=-1)
    feasible = expected >= least
    distances[~feasible] = np.inf
    chosen = np.where(feasible.any(axis=1), distances.argmin(axis=1), expected.argmax(axis=1))
    places: Array = candidates[np.arange(count), chosen]
    return places


def _candidates(
    particles: Array, targets: Array, ready: NDArray[np.bool_], region: Region, rng: np.random.Generator
) -> Array:
    """Returns the points that are tried (n, c, f); the particle itself is the first of each."""
    count, size = particles.shape
    ways = targets - particles
    lengths = np.linalg.norm(ways, axis=1)
    reach = np.minimum(region.radius, lengths)[:, None, None]
    directions = (ways / np.maximum(lengths, 1e-12)[:, None])[:, None]
    noise = rng.standard_normal((count, region.candidates, size))
    noise /= np.linalg.norm(noise, axis=-1, keepdims=True)
    noise *= rng.random((count, region.candidates, 1)) ** (1 / size)
    backwards = np.minimum((noise * directions).sum(axis=-1, keepdims=True), 0.0)
    noise -= np.where(ready[:, None, None], 2 * backwards, 0.0) * directions
    shares = np.linspace(0, 1, region.line_candidates + 1)[None, :, None]
    offsets = np.concatenate([reach * shares * directions, reach * noise], axis=1)
    candidates: Array = np.clip(particles[:, None] + offsets, 0.0, 1.0)
    return candidates
