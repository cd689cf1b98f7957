"""Kendall's tau between the order of teachers in results and in the paper's tables, and its bootstrap."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from analysis.claims.agreement import BOOTSTRAP_DRAWS, draws_of_entries, draws_of_runs, kendall, tau_interval
from analysis.statistics import Description, describe


def test_tau_is_that_of_scipy_with_ties_too() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.integers(0, 5, (2, 20, 8)).astype(float)
    expected = [stats.kendalltau(*each).statistic for each in zip(first, second, strict=True)]
    assert kendall(first, second) == pytest.approx(expected)
    assert np.isnan(kendall(np.zeros(4), np.arange(4.0)))


def test_draws_scatter_as_means_of_runs_do() -> None:
    """Of two strata of equal weight, by the variance of their runs with n - 1."""
    rng = np.random.default_rng(2)
    strata = [pd.Series([1.0, 4.0, 10.0]), pd.Series([0.0, 20.0])]
    drawn = draws_of_runs(strata, rng)
    assert drawn.shape == (BOOTSTRAP_DRAWS,)
    assert drawn.mean() == pytest.approx(7.5, abs=0.4)
    assert drawn.var() == pytest.approx((21.0 / 3 + 200.0 / 2) / 4, rel=0.1)
    assert np.isnan(draws_of_runs([pd.Series([1.0])], rng)).all()
    entries = [Description(16, 10.0, 8.0), Description(16, 20.0, 8.0)]
    assert draws_of_entries(entries, rng).mean() == pytest.approx(15.0, abs=0.1)
    assert draws_of_entries(entries, rng).std() == pytest.approx(np.sqrt(8.0) / 2, rel=0.05)


@pytest.mark.parametrize("agreeing", [0.0, 0.7])
def test_the_interval_holds_the_tau_that_other_runs_have(agreeing: float) -> None:
    """Eight teachers on six challenges, 5 and 32 seeds; true effects as large as the deviation of a run."""
    rng = np.random.default_rng(7)
    mine = rng.normal(0.0, 9.0, (6, 8))
    theirs = agreeing * mine + np.sqrt(1 - agreeing**2) * rng.normal(0.0, 9.0, (6, 8))

    def sides() -> tuple[np.ndarray, np.ndarray]:
        return rng.normal(mine[..., None], 9.0, (6, 8, 5)), rng.normal(theirs[..., None], 9.0, (6, 8, 32))

    def tau(ours: np.ndarray, papers: np.ndarray) -> float:
        return float(kendall(ours.mean(axis=-1), papers.mean(axis=-1)).mean())

    expected, held = np.mean([tau(*sides()) for _ in range(400)]), []
    for _ in range(60):
        ours, papers = sides()
        draws = [
            kendall(
                np.stack([draws_of_runs([pd.Series(runs)], rng) for runs in place], axis=-1),
                np.stack([draws_of_entries([describe(runs)], rng) for runs in other], axis=-1),
            )
            for place, other in zip(ours, papers, strict=True)
        ]
        low, high = tau_interval(tau(ours, papers), np.mean(draws, axis=0))
        assert high - low < 0.5
        held.append(low <= expected <= high)
    assert np.mean(held) > 0.88
