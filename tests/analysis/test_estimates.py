"""Interquartile means, probabilities of improvement and profiles: values by hand, intervals by simulation."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from analysis.statistics.estimates import (
    interquartile_mean_of,
    performance_profile,
    probability_of_improvement,
)
from analysis.statistics.samples import Estimate

VALUES = st.lists(st.integers(-5, 5), min_size=2, max_size=8)
SIZES = [2, 3, 5, 10, 32]


def sample(prefix: str, **strata: Sequence[float]) -> dict[str, pd.Series]:
    return {
        name: pd.Series(values, index=[f"{prefix}-{name}-{i}" for i in range(len(values))], dtype=float)
        for name, values in strata.items()
    }


def coverage(truth: float, estimate: Callable[[np.random.Generator], Estimate], draws: int) -> float:
    rng, held = np.random.default_rng(7), 0
    for _ in range(draws):
        found = estimate(rng)
        held += found.low <= truth <= found.high
    return held / draws


def normal(rng: np.random.Generator, prefix: str, mean: float, n: int, strata: int) -> dict[str, pd.Series]:
    return sample(prefix, **{f"s{i}": rng.normal(mean, 1, n) for i in range(strata)})


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
    estimate = interquartile_mean_of(sample("a", one=values))
    assert (estimate.value, estimate.n) == (pytest.approx(mean), len(values))


def test_without_trimming_the_interval_is_students() -> None:
    values = [12.0, 19.0, 23.0]
    found = interquartile_mean_of(sample("a", one=values))
    interval = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_an_outlier_moves_the_interval_no_further_than_the_middle_half() -> None:
    draws = np.random.default_rng(3).normal(20, 5, 40)
    calm, wild = (interquartile_mean_of(sample("a", one=[*draws, last])) for last in (30.0, 31.0))
    assert wild.value == pytest.approx(calm.value)


SIMULATIONS = [
    *((n, 1, 120, 0.88) for n in SIZES),
    (3, 5, 60, 0.88),
    *(pytest.param(n, strata, 4_000, 0.93, marks=pytest.mark.slow) for n in SIZES for strata in (1, 5)),
]
"""Runs a stratum, strata, simulated experiments, and the least coverage that so many let us ask for."""


@pytest.mark.parametrize(("n", "strata", "draws", "least"), SIMULATIONS)
def test_intervals_hold_on_normal_data(n: int, strata: int, draws: int, least: float) -> None:
    means = coverage(3, lambda rng: interquartile_mean_of(normal(rng, "a", 3, n, strata)), draws)
    truth = float(stats.norm.cdf(1 / math.sqrt(2)))  # a difference of one standard deviation

    def chance(rng: np.random.Generator) -> Estimate:
        return probability_of_improvement(normal(rng, "a", 1, n, strata), normal(rng, "b", 0, n, strata))

    chances = coverage(truth, chance, draws)
    assert means >= least
    assert chances >= least


def test_intervals_of_shares_hold_and_stay_within_their_bounds() -> None:
    truth = float(stats.norm.sf(0.5))
    for n in SIZES:
        rng, held = np.random.default_rng(n), 0
        for _ in range(100):
            row = performance_profile(normal(rng, "a", 0, n, 1), [0.5]).iloc[0]
            assert 0 <= row["low"] <= row["share"] <= row["high"] <= 1
            held += row["low"] <= truth <= row["high"]
        assert held / 100 >= 0.9


@given(VALUES, VALUES)
def test_the_probability_of_improvement_is_mann_and_whitneys(first: list[int], second: list[int]) -> None:
    found = probability_of_improvement(sample("a", one=first), sample("b", one=second))
    u = stats.mannwhitneyu(first, second).statistic
    assert found.value == pytest.approx(u / (len(first) * len(second)))
    assert 0 <= found.low <= found.value <= found.high <= 1
    assert found.low < found.high


def test_the_interval_of_improvement_as_published() -> None:
    # Newcombe's (2006) score interval, all of 24 pairs won; t with 8 degrees of freedom is its quantile here.
    found = probability_of_improvement(sample("a", x=[7, 8, 9, 10]), sample("b", x=[1, 2, 3, 4, 5, 6]))
    p, t = found.low, stats.t.ppf(0.975, 8)
    assert (found.value, found.high) == (1, 1)
    variance = p * (1 - p) * (1 + 4 * ((1 - p) / (2 - p) + p / (1 + p))) / 24
    assert (1 - p) ** 2 == pytest.approx(t**2 * variance)


def test_improvement_is_a_mean_over_strata() -> None:
    first = sample("a", easy=[3, 4], hard=[0, 0, 1])
    second = sample("b", easy=[1, 2], hard=[0, 0])
    found = probability_of_improvement(first, second)
    # Easy: always. Hard: of 6 pairs 4 are ties and 2 are won.
    assert found.value == pytest.approx((1 + (2 + 2) / 6) / 2)
    assert found.low <= found.value <= found.high
    other = probability_of_improvement(second, first)
    assert found.value + other.value == pytest.approx(1)
    assert (found.low + other.high, found.high + other.low) == (pytest.approx(1), pytest.approx(1))


def test_a_run_never_competes_with_itself() -> None:
    runs = sample("a", one=[1, 2, 3], two=[4, 5])
    other = sample("b", one=[1, 2, 3], two=[4, 5])
    other["two"] = runs["two"]
    for second in (runs, other, {"one": other["one"], "two": runs["two"].iloc[:1]}):
        found = probability_of_improvement(runs, second)
        assert (found.reason, math.isnan(found.value)) == ("same runs", True)


def test_other_strata_are_not_compared() -> None:
    found = probability_of_improvement(sample("a", fish=[1, 2]), sample("b", fish=[1, 2], biped=[3, 4]))
    assert (found.reason, math.isnan(found.value), found.n) == ("other strata", True, 6)


FIRST = {
    "one": [39, 53, 40, 21, 51, 42, 42, 42, 34, 68],
    "two": [41, 55, 3, 64, 63, 41, 41, 54, 40, 56],
    "three": [14, 16, 13, 17, 10, 19, 26, 9, 28, 3],
}
SECOND = {
    "one": [17, 76, 35, 26, 36, 51, 24],
    "two": [59, 35, 45, 57, 42, 53, 55],
    "three": [13, 30, 18, 15, 38, 18, 18],
}


def test_values_are_those_of_rliable() -> None:
    """Numbers that rliable 1.2.0 gives for the same runs of three tasks, ties included."""
    first, second = sample("a", **FIRST), sample("b", **SECOND)
    means = [interquartile_mean_of(each).value for each in (first, second)]
    assert means == pytest.approx([35.25, 34.54545454545455], rel=1e-12)
    chances = [probability_of_improvement(*pair).value for pair in ((first, second), (second, first))]
    assert chances == pytest.approx([0.4690476190476191, 0.530952380952381], rel=1e-12)
    shares = [list(performance_profile(each, [10, 25, 40, 55, 70])["share"]) for each in (first, second)]
    assert shares == [
        pytest.approx([26 / 30, 20 / 30, 14 / 30, 4 / 30, 0 / 30]),
        pytest.approx([21 / 21, 14 / 21, 8 / 21, 3 / 21, 1 / 21]),
    ]


def test_a_profile_is_the_share_over_each_threshold() -> None:
    profile = performance_profile(sample("a", one=[10, 20, 20, 40]), [0, 10, 15, 20, 40])
    assert list(profile["share"]) == [1, 0.75, 0.75, 0.25, 0]
    exact = stats.binomtest(3, 4).proportion_ci(0.95, method="exact")
    row = profile.set_index("threshold").loc[15]
    assert (row["low"], row["high"]) == pytest.approx((exact.low, exact.high))


def test_a_profile_and_its_intervals_only_fall() -> None:
    draws = np.random.default_rng(12)
    runs = sample("a", fish=draws.normal(20, 15, 16), biped=draws.normal(30, 10, 16))
    profile = performance_profile(runs, list(range(0, 60, 2)))
    assert (profile[["share", "low", "high"]].diff().dropna() <= 0).all(axis=None)


def test_one_seed_of_a_stratum_gives_a_value_without_an_interval() -> None:
    found = interquartile_mean_of(sample("a", fish=[5], biped=[1, 3]))
    assert (found.value, found.n, found.reason) == (3, 3, "needs 2 seeds")
    assert np.isnan([found.low, found.high]).all()


def test_without_results_there_is_no_number_and_runs_without_a_value_do_not_count() -> None:
    empty = sample("a", fish=[], biped=[math.nan, math.nan])
    assert interquartile_mean_of(empty).reason == "no results"
    assert probability_of_improvement(empty, sample("b")).reason == "no results"
    assert probability_of_improvement(empty, sample("b", fish=[1, 2])).reason == "other strata"
    assert performance_profile(empty, [0.0])["share"].isna().all()
    some = interquartile_mean_of(sample("a", fish=[1, math.nan, 3, math.inf]))
    assert (some.value, some.n, some.reason) == (2, 2, "")


def test_rounding_errors_are_no_spread_and_no_wins() -> None:
    constant = {"a": pd.Series([0.1] * 3, list("xyz")), "b": pd.Series([0.1] * 3, list("uvw"))}
    mean = interquartile_mean_of(constant)
    assert mean.low == mean.value == mean.high
    clusters = dict(zip("xyzuvw", [1, 2, 3] * 2, strict=True))
    assert interquartile_mean_of(constant, clusters).low == mean.value
    nearly = {"a": pd.Series([0.3] * 3, list("xyz"))}, {"a": pd.Series([0.1 * 3] * 3, list("uvw"))}
    assert nearly[0]["a"].iloc[0] < nearly[1]["a"].iloc[0]
    assert probability_of_improvement(*nearly).value == 0.5
