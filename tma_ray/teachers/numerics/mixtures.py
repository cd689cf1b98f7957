"""Gaussian mixtures chosen by AIC: the task distribution of the GMM teachers."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

Array = NDArray[np.float64]


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

    One EM initialisation each, without warm start. One thread, so that where a teacher runs does
    not change what it fits.

    Args:
        rows: data (n, c); sizes beyond n - 1 components are not tried.
        most_components: largest number of components, included.
        seed: of scikit-learn's initialisation.
    """
    # Imported here: drivers and workers that name a teacher and fit nothing start sooner without it.
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    sizes = range(2, min(most_components, len(rows) - 1) + 1)
    with threadpool_limits(limits=1), warnings.catch_warnings():
        # Twin rows and few episodes leave components empty: EM then stops early, which is fine here.
        warnings.simplefilter("ignore", ConvergenceWarning)
        fits = [GaussianMixture(size, covariance_type="full", random_state=seed).fit(rows) for size in sizes]
        best = min(fits, key=lambda fit: float(fit.aic(rows)))
    return Mixture(best.weights_, best.means_, best.covariances_)
