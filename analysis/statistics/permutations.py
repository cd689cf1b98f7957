"""Permutation tests: p-values of differences that need no standard deviation, exact for small samples.

Under the null hypothesis it makes no difference which runs a sample has (or, of paired runs, which one comes
first), so that every arrangement is as likely as the one that was found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

MOST = 20_000
"""Arrangements up to which all are looked at: two samples of 8 runs have 12,870."""

DRAWN = 9_999
"""Arrangements that are drawn of more, so that the smallest p is 1 in 10,000 (Davison and Hinkley, 1997)."""

SEED = 0
"""Of the draws: the same samples always have the same p."""

EQUAL = 1e-9
"""Differences closer than this share of the largest value are equal."""

Floats = NDArray[np.float64]


def permutation_p(pairs: Sequence[tuple[ArrayLike, ArrayLike]], weights: Sequence[float] = (1.0,)) -> float:
    """Returns the two-sided p-value of a weighted mean of differences between two groups over strata.

    Runs change groups within their stratum only.

    Args:
        pairs: values of both groups in each stratum, (n,) and (m,), at least one each.
        weights: of the strata.
    """
    strata = [tuple(np.asarray(group, np.float64) for group in pair) for pair in pairs]
    found = sum(weight * (a.mean() - b.mean()) for weight, (a, b) in zip(weights, strata, strict=True))
    counts = [math.comb(len(a) + len(b), len(a)) for a, b in strata]
    scale = max(float(np.abs(np.concatenate(stratum)).max()) for stratum in strata) * sum(weights)
    if math.prod(counts) <= MOST:
        differences = np.zeros(1)
        for weight, (a, b) in zip(weights, strata, strict=True):
            differences = np.add.outer(differences, weight * _all_differences(a, b)).ravel()
        return _share(differences, found, scale)
    rng = np.random.default_rng(SEED)
    parts = zip(weights, strata, strict=True)
    drawn = np.sum([weight * _drawn_differences(a, b, rng) for weight, (a, b) in parts], axis=0)
    return _share(np.append(drawn, found), found, scale)


def sign_flip_p(differences: ArrayLike) -> float:
    """Returns the two-sided p-value of the mean of paired differences (n,): each may have either sign."""
    values = np.asarray(differences, np.float64)
    found, scale = float(values.mean()), float(np.abs(values).max())
    if 2 ** len(values) <= MOST:
        signs = np.array(list(itertools.product((1.0, -1.0), repeat=len(values))))
        return _share(signs @ values / len(values), found, scale)
    signs = np.random.default_rng(SEED).choice((1.0, -1.0), (DRAWN, len(values)))
    return _share(np.append(signs @ values / len(values), found), found, scale)


def _share(differences: Floats, found: float, scale: float) -> float:
    """Returns the share of `differences` that are at least as far from 0 as the one `found`."""
    return float(np.mean(np.abs(differences) >= abs(found) - EQUAL * scale))


def _all_differences(a: Floats, b: Floats) -> Floats:
    values = np.concatenate([a, b])
    chosen = np.array(list(itertools.combinations(range(len(values)), len(a))))
    return _differences(values[chosen].sum(axis=1), values.sum(), len(a), len(b))


def _drawn_differences(a: Floats, b: Floats, rng: np.random.Generator) -> Floats:
    values = np.concatenate([a, b])
    drawn = rng.permuted(np.broadcast_to(values, (DRAWN, len(values))), axis=1)
    return _differences(drawn[:, : len(a)].sum(axis=1), values.sum(), len(a), len(b))


def _differences(sums: Floats, total: float, n: int, m: int) -> Floats:
    return np.asarray(sums / n - (total - sums) / m, np.float64)
