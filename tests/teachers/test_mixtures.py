from __future__ import annotations

import numpy as np
import pytest
from sklearn.mixture import GaussianMixture
from threadpoolctl import threadpool_limits

from tma_ray.teachers.mixtures import fit_mixture


@pytest.mark.parametrize(("columns", "most_components"), [(1, 6), (3, 6), (9, 3)])
def test_a_fit_is_the_one_of_scikit_learn_with_the_lowest_aic(columns: int, most_components: int) -> None:
    rng = np.random.default_rng(columns)
    centres = rng.uniform(0, 10, (3, columns)) * ([1] * (columns - 1) + [30])
    rows = np.concatenate(
        [rng.normal(centre, 1 + index, (40, columns)) for index, centre in enumerate(centres)]
    )
    with threadpool_limits(limits=1):
        fits = [GaussianMixture(size, random_state=7).fit(rows) for size in range(2, most_components + 1)]
        best = min(fits, key=lambda fit: fit.aic(rows))
    mixture = fit_mixture(rows, most_components, seed=7)
    np.testing.assert_allclose(mixture.weights, best.weights_, rtol=1e-9)
    np.testing.assert_allclose(mixture.means, best.means_, rtol=1e-9)
    np.testing.assert_allclose(mixture.covariances, best.covariances_, rtol=1e-7, atol=1e-9)


def test_rows_that_coincide_are_fitted_and_can_be_drawn_from() -> None:
    rows = np.tile([1.0, 2.0, 300.0], (150, 1))
    mixture = fit_mixture(rows, 10, seed=0)
    drawn = [mixture.draw(index, np.random.default_rng(0)) for index in range(len(mixture))]
    assert any(np.allclose(point, rows[0], atol=0.01) for point in drawn)
