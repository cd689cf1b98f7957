"""Gaussian mixtures chosen by AIC: the task distribution of the GMM teachers."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits

Array = NDArray[np.float64]

MOST_ITERATIONS = 100
SMALLEST_GAIN = 1e-3
"""EM ends when the mean log-likelihood of a row changes by less, or after as many iterations; these and
the next one are scikit-learn's defaults, as the original release uses them."""

ADDED_VARIANCE = 1e-6
"""Added to the variance of every coordinate, in its unit squared, so that no component is singular."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A fitted mixture as plain arrays.

    Attributes:
        weights: (k,) share of the data in each component.
        means: (k, c).
        covariances: (k, c, c).
    """

    weights: Array
    means: Array
    covariances: Array

    def __len__(self) -> int:
        return len(self.weights)

    def draw(self, component: int, rng: np.random.Generator) -> Array:
        """Returns one point (c,) of `component`."""
        factor = np.linalg.cholesky(self.covariances[component])
        drawn: Array = self.means[component] + factor @ rng.standard_normal(self.means.shape[1])
        return drawn


def fit_mixture(rows: Array, most_components: int, seed: int) -> Mixture:
    """Returns the full-covariance mixture of 2 to `most_components` components with the lowest AIC.

    Each is fitted by expectation maximisation (EM) from one k-means clustering. The result is that of
    scikit-learn's `GaussianMixture`, but all components are computed at once, which takes a third
    of the time. One thread, so that where a teacher runs does not change what it fits.

    Args:
        rows: data (n, c); sizes beyond n - 1 components are not tried.
        most_components: largest number of components, included.
        seed: of the clustering.
    """
    sizes = range(2, min(most_components, len(rows) - 1) + 1)
    with threadpool_limits(limits=1), warnings.catch_warnings():
        # Twin rows give fewer clusters than asked for: components without rows do no harm here.
        warnings.simplefilter("ignore", ConvergenceWarning)
        fits = [_fit(rows, size, seed) for size in sizes]
        return min(fits, key=lambda fit: _aic(fit, rows))


def _fit(rows: Array, size: int, seed: int) -> Mixture:
    labels = KMeans(size, n_init=1, random_state=seed).fit(rows).labels_
    mixture = _maximise(rows, (labels == np.arange(size)[:, None]).astype(np.float64))
    before = -np.inf
    for _ in range(MOST_ITERATIONS):
        densities = _log_densities(mixture, rows)
        of_rows = np.logaddexp.reduce(densities)
        mixture = _maximise(rows, np.exp(densities - of_rows))
        likelihood = float(of_rows.mean())
        if abs(likelihood - before) < SMALLEST_GAIN:
            break
        before = likelihood
    return mixture


def _maximise(rows: Array, shares: Array) -> Mixture:
    """Returns the likeliest mixture when `shares` (k, n) of the rows belong to each component."""
    counts = shares.sum(axis=1) + 10 * np.finfo(np.float64).eps
    means = shares @ rows / counts[:, None]
    centred = rows - means[:, None]
    covariances = (shares[:, :, None] * centred).transpose(0, 2, 1) @ centred / counts[:, None, None]
    covariances += ADDED_VARIANCE * np.eye(rows.shape[1])
    return Mixture(counts / counts.sum(), means, covariances)


def _log_densities(mixture: Mixture, rows: Array) -> Array:
    """Returns the logarithm of weight times density (k, n) of every component at every row."""
    size = rows.shape[1]
    whitening = np.linalg.inv(np.linalg.cholesky(mixture.covariances))
    whitened = (rows - mixture.means[:, None]) @ whitening.transpose(0, 2, 1)
    log_scale = np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1) - size / 2 * np.log(2 * np.pi)
    densities: Array = (np.log(mixture.weights) + log_scale)[:, None] - np.sum(whitened**2, axis=2) / 2
    return densities


def _aic(mixture: Mixture, rows: Array) -> float:
    """Returns Akaike's information criterion: twice (free parameters - log-likelihood)."""
    components, size = mixture.means.shape
    parameters = components * (size * (size + 1) / 2 + size + 1) - 1
    return float(2 * (parameters - np.logaddexp.reduce(_log_densities(mixture, rows)).sum()))
