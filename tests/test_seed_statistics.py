"""Statistics of seeds that benchmarks use: closed forms, the distribution of draws, coverage of intervals."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from seed_statistics import least_correlation, pairing_helps, seed_correlation, signal_to_noise

from analysis.comparisons import budgets
from analysis.comparisons.budgets import effect_correlation
from analysis.statistics import paired, welch
from analysis.statistics.samples import Estimate

Spaces = list[dict[str, np.ndarray]]


def spaces_of(
    rng: np.random.Generator,
    true: float,
    signal: float = 2.0,
    seeds: int = 3,
    spaces: int = 4,
    teachers: int = 10,
) -> Spaces:
    """Normal effects with a true correlation, and luck that both measures share by a half."""
    effects = signal * rng.multivariate_normal([0, 0], [[1, true], [true, 1]], (spaces, teachers))
    luck = rng.multivariate_normal([0, 0], [[1, 0.5], [0.5, 1]], (spaces, teachers, seeds))
    return [{str(name): values for name, values in enumerate(space)} for space in effects[:, :, None] + luck]


def test_the_covariance_of_seeds_is_subtracted() -> None:
    """Two spaces whose mean squares and products can be computed by hand."""
    means = np.array([[0.0, 0.0], [6.0, 3.0], [12.0, 12.0]])
    luck = np.array([[1.0, 1.0], [-1.0, -1.0]])
    space = {str(name): mean + luck for name, mean in enumerate(means)}
    found = effect_correlation([space, space])
    # Effects are ±6 and 0, and -5, -2 and 7; n = 2, f = 4, g = 6, W = 2 everywhere.
    squares = 2 * 2 * np.array([[72.0, 72.0], [72.0, 78.0]]) / 4
    expected = (squares - 2) / 2
    assert found.value == pytest.approx(expected[0, 1] / math.sqrt(expected[0, 0] * expected[1, 1]))
    assert found.observed == pytest.approx(72 / math.sqrt(72 * 78))
    assert found.n == 12
    assert found.low < found.value < found.high


def test_one_measure_agrees_with_itself_in_another_unit() -> None:
    drawn = spaces_of(rng(1), 0.5)
    values = [{name: runs[:, :1] * [1.0, -3.0] for name, runs in space.items()} for space in drawn]
    found = effect_correlation(values)
    assert (found.value, found.low, found.high) == pytest.approx((-1, -1, -1))


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_scale_and_level_of_a_space_make_no_difference() -> None:
    spaces = spaces_of(rng(2), 0.7)
    moved = [
        {name: 5.0 * runs + 100.0 * place for name, runs in space.items()}
        for place, space in enumerate(spaces)
    ]
    first, second = effect_correlation(spaces), effect_correlation(moved)
    assert (first.value, first.low, first.high) == pytest.approx((second.value, second.low, second.high))


def test_draws_have_the_inverse_wishart_distribution() -> None:
    covariance, freedom = np.array([[4.0, 1.0], [1.0, 2.0]]), 12
    drawn = budgets._drawn(covariance, freedom, rng(3))
    reference = stats.invwishart(df=freedom, scale=freedom * covariance)
    assert drawn.mean(axis=0) == pytest.approx(reference.mean(), rel=0.03)
    assert drawn.var(axis=0) == pytest.approx(reference.var(), rel=0.1)


@pytest.mark.parametrize("true", [0.0, 0.84])
def test_intervals_hold_and_estimates_are_unbiased(true: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budgets, "CORRELATION_DRAWS", 1_000)
    generator = rng(4)
    found = [effect_correlation(spaces_of(generator, true, signal=1.0)) for _ in range(200)]
    assert np.mean([each.low <= true <= each.high for each in found]) > 0.91
    assert np.mean([each.value for each in found]) == pytest.approx(true, abs=0.05)
    biased = np.mean([each.observed for each in found]) - true
    assert abs(biased) > 0.04


def test_without_effects_there_is_no_interval() -> None:
    seeds = np.array([[1.0, 2.0], [-1.0, -2.0], [0.5, -0.5]])
    found = effect_correlation([dict.fromkeys("abcd", seeds), dict.fromkeys("abcd", seeds)])
    assert found.reason == "teachers differ by no more than chance"
    assert math.isnan(found.low)


@pytest.mark.parametrize(("teachers", "seeds"), [(1, 5), (3, 1), (2, 3)])
def test_too_few_teachers_or_seeds_are_named(teachers: int, seeds: int) -> None:
    found = effect_correlation(spaces_of(rng(5), 0.5, seeds=seeds, spaces=1, teachers=teachers))
    assert found.reason == "needs 4 degrees of freedom"
    assert math.isnan(found.value)


def test_the_correlation_of_seeds_holds_the_true_one() -> None:
    rng, true, held = np.random.default_rng(6), 0.5, 0
    for _ in range(400):
        tables = [rng.normal(0, 1, (6, 1)) + rng.normal(0, 1, (6, 3)) + rng.normal(0, 9, 3) for _ in range(4)]
        found = seed_correlation(tables)
        held += found.low <= true <= found.high
    assert 0.92 <= held / 400 <= 0.99


@pytest.mark.slow
def test_pairing_needs_more_correlation_the_fewer_the_runs() -> None:
    assert least_correlation(2) > least_correlation(5) > least_correlation(32) > 0
    rng = np.random.default_rng(7)
    n = 5
    for correlation, narrower in ((least_correlation(n) - 0.2, False), (least_correlation(n) + 0.2, True)):
        covariance = [[1, correlation], [correlation, 1]]
        widths = np.zeros(2)
        for _ in range(2_000):
            both = rng.multivariate_normal([0, 0], covariance, n).T
            of_pairs = paired(*map(pd.Series, both))
            of_both = welch(pd.Series(both[0], list("abcde")), pd.Series(both[1], list("fghij")))
            widths += [of_pairs.high - of_pairs.low, of_both.high - of_both.low]
        assert (widths[0] < widths[1]) == narrower
    assert pairing_helps(Estimate(0.9, 0.8, 1.0, 1), n)
    assert not pairing_helps(Estimate(0.9, 0.1, 1.0, 1), n)


def test_signal_to_noise_of_one_stratum_is_that_of_fishers_f() -> None:
    draws = np.random.default_rng(2).normal(size=(5, 6)) + np.array([0, 1, 2, 3, 4])[:, None]
    found = signal_to_noise([dict(enumerate(draws))])
    f = stats.f_oneway(*draws).statistic
    assert found.value == pytest.approx(math.sqrt((f * 23 / 25 - 1) / 6))
    ends = [math.sqrt((f / stats.f.ppf(share, 4, 25) - 1) / 6) for share in (0.975, 0.025)]
    assert (found.low, found.high) == pytest.approx(tuple(ends))
    assert signal_to_noise([dict(enumerate(1000 * draws - 7))]).value == pytest.approx(found.value)


def test_signal_to_noise_pools_strata_and_does_not_count_their_levels() -> None:
    rng, effects = np.random.default_rng(3), np.array([-1.0, 0.0, 1.0])
    strata = [dict(enumerate(level + effects[:, None] + rng.normal(0, 0.5, (3, 400)))) for level in (0, 50)]
    found = signal_to_noise(strata)
    # A deviation of 1 between teachers, of 0.5 between seeds.
    assert found.value == pytest.approx(2.0, abs=0.1)
    assert found.low < 2 < found.high


def test_signal_to_noise_is_right_on_average_and_its_interval_holds() -> None:
    truth, rng, squares = 0.8, np.random.default_rng(4), []

    def estimate(draw: np.random.Generator) -> Estimate:
        strata = truth * draw.normal(size=(3, 4, 1)) + draw.normal(size=(3, 4, 4))
        found = signal_to_noise([dict(enumerate(stratum)) for stratum in strata])
        squares.append(found.value**2)
        return found

    draws = np.random.default_rng(7)
    held = [each.low <= truth <= each.high for each in (estimate(draws) for _ in range(1500))]
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)
    assert np.mean(squares) == pytest.approx(truth**2, abs=0.03)  # hardly ever cut at 0 here
    alike = [signal_to_noise([dict(enumerate(rng.normal(size=(4, 4))))]).value for _ in range(50)]
    assert np.median(alike) < 0.2


@pytest.mark.parametrize("strata", [[], [{"a": [1, 2, 3, 4, 5]}], [{"a": [1, 2, 3, 4], "b": [1]}]])
def test_signal_to_noise_needs_teachers_and_seeds(strata: list[dict[str, list[float]]]) -> None:
    found = signal_to_noise(strata)
    assert found.reason == "needs 2 teachers and 2 seeds"
    assert math.isnan(found.value)


def test_teachers_without_spread_have_an_infinite_signal() -> None:
    assert signal_to_noise([{"a": [0.1] * 3, "b": [0.7] * 3}]).value == math.inf
