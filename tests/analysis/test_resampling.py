import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from analysis.resampling import (
    bootstrap_interquartile_mean,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
)

VALUES = st.lists(st.integers(-5, 5), min_size=2, max_size=8)


def sample(prefix: str, **strata: Sequence[float]) -> dict[str, pd.Series]:
    return {
        name: pd.Series(values, index=[f"{prefix}-{name}-{i}" for i in range(len(values))], dtype=float)
        for name, values in strata.items()
    }


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.mark.parametrize(
    ("values", "mean"),
    [
        ([8, 1, 100, 3, 2, 4, -50, 6], 15 / 4),  # 2, 3, 4, 6 remain of 8
        ([9, 0, 1, 2, 100], 4),  # one of 5 is cut at each end
        ([1, 2, 6], 3),  # a quarter of 3 is none
        ([7], 7),
    ],
)
def test_the_interquartile_mean_by_hand(values: list[float], mean: float) -> None:
    assert interquartile_mean(values) == pytest.approx(mean)
    estimate = bootstrap_interquartile_mean(sample("a", one=values), rng(), 50)
    assert (estimate.value, estimate.n) == (pytest.approx(mean), len(values))


def test_the_interval_of_the_interquartile_mean_covers_as_it_says() -> None:
    draws, covered = np.random.default_rng(7), 0
    for _ in range(300):
        found = bootstrap_interquartile_mean(sample("a", one=draws.normal(3, 2, 32)), draws, 400)
        covered += found.low <= 3 <= found.high
    # Percentile intervals of 32 values are a little short; 0.013 is the simulation's own error.
    assert 0.89 <= covered / 300 <= 0.98


def test_resampling_keeps_to_its_strata() -> None:
    # Within strata there is no spread, so that nothing can change but which stratum a run is drawn from.
    apart = bootstrap_interquartile_mean(sample("a", low=[0.0] * 6, high=[10.0] * 6), rng(), 200)
    assert (apart.value, apart.low, apart.high) == (5, 5, 5)
    mixed = bootstrap_interquartile_mean(sample("a", all=[0.0] * 6 + [10.0] * 6), rng(), 200)
    assert mixed.low < 5 < mixed.high


def test_the_interval_is_the_bootstrap_done_by_hand() -> None:
    draws = np.random.default_rng(11)
    fish, biped = draws.normal(20, 15, 16), draws.normal(30, 10, 16)
    found = bootstrap_interquartile_mean(sample("a", fish=fish, biped=biped), rng(), 5_000)
    by_hand = [
        interquartile_mean(np.concatenate([draws.choice(fish, 16), draws.choice(biped, 16)]))
        for _ in range(2_000)
    ]
    assert [found.low, found.high] == pytest.approx(np.percentile(by_hand, [2.5, 97.5]), abs=0.8)


@settings(deadline=None)  # machines may be busy
@given(VALUES, VALUES)
def test_the_probability_of_improvement_is_mann_and_whitneys(first: list[int], second: list[int]) -> None:
    found = probability_of_improvement(sample("a", one=first), sample("b", one=second), rng(), 2)
    u = stats.mannwhitneyu(first, second).statistic
    assert found.value == pytest.approx(u / (len(first) * len(second)))


def test_improvement_is_a_mean_over_strata() -> None:
    first = sample("a", easy=[3, 4], hard=[0, 0, 1])
    second = sample("b", easy=[1, 2], hard=[0, 0])
    found = probability_of_improvement(first, second, rng(), 200)
    # Easy: always. Hard: of 6 pairs 4 are ties and 2 are won.
    assert found.value == pytest.approx((1 + (2 + 2) / 6) / 2)
    assert found.low <= found.value <= found.high
    other = probability_of_improvement(second, first, rng(), 200)
    assert found.value + other.value == pytest.approx(1)


def test_the_interval_of_improvement_covers_as_it_says() -> None:
    draws, covered, trials = np.random.default_rng(8), 0, 200
    truth = stats.norm.cdf(1 / math.sqrt(2))  # a difference of one standard deviation
    for _ in range(trials):
        first, second = draws.normal(1, 1, 24), draws.normal(0, 1, 24)
        found = probability_of_improvement(sample("a", x=first), sample("b", x=second), draws, 300)
        covered += found.low <= truth <= found.high
    assert 0.88 <= covered / trials <= 0.99


def test_a_run_never_competes_with_itself() -> None:
    runs = sample("a", one=[1, 2, 3], two=[4, 5])
    other = sample("b", one=[1, 2, 3], two=[4, 5])
    other["two"] = runs["two"]
    for second in (runs, other, {"one": other["one"], "two": runs["two"].iloc[:1]}):
        found = probability_of_improvement(runs, second, rng())
        assert (found.reason, math.isnan(found.value)) == ("same runs", True)


def test_other_strata_are_not_compared() -> None:
    found = probability_of_improvement(
        sample("a", fish=[1, 2]), sample("b", fish=[1, 2], biped=[3, 4]), rng()
    )
    assert (found.reason, math.isnan(found.value), found.n) == ("other strata", True, 6)


def test_a_profile_is_the_share_over_each_threshold() -> None:
    profile = performance_profile(sample("a", one=[10, 20, 20, 40]), [0, 10, 15, 20, 40], rng(), 500)
    assert list(profile["share"]) == [1, 0.75, 0.75, 0.25, 0]
    assert (profile["low"] <= profile["share"]).all()
    assert (profile["share"] <= profile["high"]).all()
    assert profile.set_index("threshold").loc[0, "low"] == 1
    # Of 4 draws k exceed 15 by the binomial distribution: 1 of 4 or fewer in 5 % of all samples, 0 in 0.4 %.
    assert profile.set_index("threshold").loc[15, "low"] == 0.25


def test_a_profile_and_its_band_only_fall() -> None:
    draws = np.random.default_rng(12)
    runs = sample("a", fish=draws.normal(20, 15, 16), biped=draws.normal(30, 10, 16))
    profile = performance_profile(runs, list(range(0, 60, 2)), draws, 200)
    assert (profile[["share", "low", "high"]].diff().dropna() <= 0).all(axis=None)


def test_one_seed_of_a_stratum_gives_a_value_without_an_interval() -> None:
    found = bootstrap_interquartile_mean(sample("a", fish=[5], biped=[1, 3]), rng())
    assert (found.value, found.n, found.reason) == (3, 3, "needs 2 seeds")
    assert math.isnan(found.low)
    assert math.isnan(found.high)


def test_without_results_there_is_no_number() -> None:
    empty = sample("a", fish=[], biped=[math.nan, math.nan])
    assert bootstrap_interquartile_mean(empty, rng()).reason == "no results"
    assert probability_of_improvement(empty, sample("b"), rng()).reason == "no results"
    assert probability_of_improvement(empty, sample("b", fish=[1, 2]), rng()).reason == "other strata"
    assert performance_profile(empty, [0.0], rng())["share"].isna().all()


def test_runs_without_a_value_do_not_count() -> None:
    found = bootstrap_interquartile_mean(sample("a", fish=[1, math.nan, 3, math.inf]), rng(), 50)
    assert (found.value, found.n, found.reason) == (2, 2, "")


def test_the_same_draws_give_the_same_numbers() -> None:
    runs, others = sample("a", x=[1, 5, 9, 2], y=[3, 4]), sample("b", y=[2, 4, 6], x=[0, 1])
    backwards = dict(reversed(runs.items()))
    for estimate in (
        lambda strata, draws: bootstrap_interquartile_mean(strata, draws, 100),
        lambda strata, draws: probability_of_improvement(strata, others, draws, 100),
    ):
        assert estimate(runs, rng()) == estimate(backwards, rng())
