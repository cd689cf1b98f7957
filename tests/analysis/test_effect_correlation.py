"""Correlations of true effects: closed forms, the distribution of draws, and coverage of intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from analysis.statistics import agreement
from analysis.statistics.agreement import effect_correlation

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
    values = [
        {name: runs[:, :1] * [1.0, -3.0] for name, runs in space.items()} for space in spaces_of(rng(1), 0.5)
    ]
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
    drawn = agreement._drawn(covariance, freedom, rng(3))
    reference = stats.invwishart(df=freedom, scale=freedom * covariance)
    assert drawn.mean(axis=0) == pytest.approx(reference.mean(), rel=0.03)
    assert drawn.var(axis=0) == pytest.approx(reference.var(), rel=0.1)


@pytest.mark.parametrize("true", [0.0, 0.84])
def test_intervals_hold_and_estimates_are_unbiased(true: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agreement, "CORRELATION_DRAWS", 1_000)
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
