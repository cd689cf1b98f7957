"""Tests and intervals against closed forms and other libraries, from runs and from published statistics."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from synthetic_pools import cells, pool

from analysis.comparisons.pairwise import pairwise, pairwise_from_statistics
from analysis.comparisons.ranks import ranks
from analysis.comparisons.sentences import ranked
from analysis.data.reference import paper_frame
from analysis.measures.pooling import pooled
from analysis.measures.tested import verdict
from analysis.statistics import (
    Description,
    Method,
    describe,
    holm,
    least_variance,
    paired,
    percent_interval,
    stratified,
    welch,
    welch_from_statistics,
)
from analysis.statistics.tests import permutation_p, sign_flip_p


def sample(values: Sequence[float], prefix: str) -> pd.Series:
    return pd.Series(values, index=[f"{prefix}{i}" for i in range(len(values))], dtype=float)


def test_welch_by_hand() -> None:
    # Means 3 and 6, variances 2.5 and 10, so the squared standard error is 0.5 + 2.
    result = welch(sample([1, 2, 3, 4, 5], "a"), sample([2, 4, 6, 8, 10], "b"))
    assert result.difference == -3
    assert result.t == pytest.approx(-3 / math.sqrt(2.5))
    assert result.degrees_of_freedom == pytest.approx(2.5**2 / (0.5**2 / 4 + 2**2 / 4))
    assert (result.n, result.reference_n, result.reason) == (5, 5, "")


def test_welch_on_a_published_example() -> None:
    # Textbook samples of equal size, often cited with t = -2.46, 25.0 degrees of freedom, p = 0.021.
    first = [27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7, 21.4]
    second = [27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 20.5, 24.4]
    result = welch(sample(first, "a"), sample(second, "b"))
    assert result.t == pytest.approx(-2.46, abs=0.005)
    assert result.degrees_of_freedom == pytest.approx(25.0, abs=0.05)
    assert result.p == pytest.approx(0.021, abs=0.0005)
    assert result.significant


def test_welch_agrees_with_scipy() -> None:
    rng = np.random.default_rng(1)
    for n, m in ((2, 2), (3, 8), (32, 16)):
        first, second = sample(rng.normal(40, 6, n), "a"), sample(rng.normal(35, 15, m), "b")
        ours = welch(first, second)
        assert ours == welch_from_statistics(describe(first), describe(second))
        theirs = stats.ttest_ind(first, second, equal_var=False)
        interval = theirs.confidence_interval(0.95)
        expected = [theirs.statistic, theirs.df, theirs.pvalue, interval.low, interval.high]
        np.testing.assert_allclose([ours.t, ours.degrees_of_freedom, ours.p, ours.low, ours.high], expected)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        # Welch's own setting: unequal spread in unequal samples.
        ((48, 26.4, 25.7), (48, 16.9, 18.3)),
        ((32, 42.8, 6.6), (32, 18.0, 10.5)),
        ((2, 1.0, 0.5), (40, 2.0, 3.0)),
    ],
)
def test_welch_of_means_is_scipys(first: tuple[int, float, float], second: tuple[int, float, float]) -> None:
    ours = welch_from_statistics(Description(*first), Description(*second))
    (n, mean, std), (m, other, spread) = first, second
    theirs = stats.ttest_ind_from_stats(mean, std, n, other, spread, m, equal_var=False)
    np.testing.assert_allclose([ours.t, ours.p], [theirs.statistic, theirs.pvalue])
    assert (ours.n, ours.reference_n, ours.difference) == (n, m, mean - other)


def test_a_mean_published_without_its_spread_is_not_tested() -> None:
    result = welch_from_statistics(Description(16, 1.0, math.nan), Description(16, 2.0, 1.0))
    assert (result.reason, result.difference) == ("no standard deviation", -1.0)
    assert welch_from_statistics(Description(1, 1.0, 0.0), Description(9, 2.0, 1.0)).reason == "needs 2 seeds"


def test_a_sample_without_spread_is_tested_by_permutation() -> None:
    # Random masters nothing with any seed.
    values = [1.0, 2.0, 4.0, 5.0]
    result = welch(sample(values, "a"), sample([0.0] * 4, "b"))
    gap = lambda x, y, axis: x.mean(axis) - y.mean(axis)  # noqa: E731
    found = stats.permutation_test((values, [0.0] * 4), gap, vectorized=True)
    assert result.p == pytest.approx(found.pvalue)
    assert (result.method, result.significant) == (Method.PERMUTATION, True)
    margin = stats.t.ppf(0.975, 3) * np.std(values, ddof=1) / 2
    assert (result.low, result.high) == pytest.approx((3 - margin, 3 + margin))
    few = welch(sample([60.0, 61.0, 62.0], "a"), sample([0.0] * 3, "b"))  # nothing: the interval holds 0
    assert (few.p, few.low) == (pytest.approx(2 / 20), 0.0)
    assert few.high > 61


def test_samples_without_any_spread_have_a_p_and_no_interval() -> None:
    first, second = sample([50.0] * 5, "a"), sample([0.0] * 5, "b")
    published = welch_from_statistics(describe(first), describe(second))
    for result in (welch(first, second), published, stratified([(first, second)], [1.0])):
        assert result.p == pytest.approx(2 / math.comb(10, 5))
        assert (result.reason, result.significant) == ("", True)
        assert np.isnan([result.low, result.high]).all()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_rounding_errors_are_no_spread(scale: float) -> None:
    """Even the mean of three equal values can differ from each of them in the last bit."""
    assert np.full(3, 0.1).std(ddof=1) > 0
    rounded = scale * np.array([1 - 1e-15, 1.0, 1 + 1e-15])
    values = {"a": 0.1, "b": 0.7, "c": 0.1}
    low, high, same = (sample(list(value * rounded), prefix) for prefix, value in values.items())
    assert describe(low).std == 0
    assert least_variance(map(describe, [low, high])) == 0
    for result in (welch(low, high), stratified([(low, high)], [1.0])):
        assert (result.method, result.p) == (Method.PERMUTATION, pytest.approx(2 / math.comb(6, 3)))
        assert np.isnan([result.low, result.high]).all()
    for result in (welch(low, same), stratified([(low, same)], [1.0])):
        assert (result.method, result.reason) == (Method.NONE, "no spread between seeds")
    published = [Description(3, each.mean(), each.to_numpy().std(ddof=1)) for each in (low, high)]
    assert welch_from_statistics(*published).p == pytest.approx(0.1)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_rounding_errors_of_pairs_are_no_spread(scale: float) -> None:
    first, second = pd.Series([0.3, 0.5, 0.2]), pd.Series([0.2, 0.4, 0.1])
    assert (first - second).std() > 0
    result = paired(scale * first, scale * second)
    assert (result.method, result.p) == (Method.SIGN_FLIP, pytest.approx(2 / 2**3))
    again = paired(scale * first, scale * (second + 0.1))
    assert (again.method, again.reason) == (Method.NONE, "no spread between seeds")


def test_ranking_and_ranks_agree_on_equal_seeds() -> None:
    runs = pool(*cells({"adr": [21.0] * 3, "alp_gmm": [18.0] * 3, "random": [18.0] * 3}))
    verdicts = ranked(runs).set_index("teacher").apply(verdict, axis=1)
    assert verdicts[["adr", "alp_gmm"]].tolist() == ["not distinguishable", "no spread between seeds"]
    for rank in ranks(runs):
        assert (rank.better, rank.worse, rank.best, rank.worst) == ((), (), 1, 3)
        assert "as the tests confirm" not in rank.describe()


def test_strata_without_any_spread_are_permuted_within_themselves() -> None:
    pairs = [(sample([9.0, 9.0], f"a{i}"), sample([0.0, 0.0], f"b{i}")) for i in range(3)]
    # In each stratum 1 of 6 arrangements is the one found, and 1 its contrary.
    assert stratified(pairs, [1.0, 1.0, 1.0]).p == pytest.approx(2 / 6**3)


def test_a_variance_under_the_least_of_its_stratum_counts_as_that() -> None:
    """In the standard error; the degrees of freedom stay, so that p is never smaller."""
    steady, scattered = [5.0, 5.1, 4.9], [1.0, 4.0, 10.0]
    lucky, other = sample([9.0, 9.2, 9.1], "a"), sample([0.0, 6.0, 3.0], "b")
    groups = lucky, other, sample(steady, "c"), sample(scattered, "d"), sample([7.0], "e")
    least = least_variance(map(describe, groups))
    variances = [np.var(each, ddof=1) for each in (lucky, other, steady, scattered)]
    assert least == pytest.approx(np.mean(variances) / 2)
    pairs, weights = [(lucky, other)] * 2, [1.0, 3.0]
    found, alone = stratified(pairs, weights, [least] * 2), stratified(pairs, weights)
    error = math.sqrt((1 + 9) / 16 * (least + variances[1]) / 3)
    assert variances[0] < least < variances[1]
    assert found.t == pytest.approx(found.difference / error)
    assert found.degrees_of_freedom == alone.degrees_of_freedom
    assert found.p > alone.p
    assert least_variance([describe(sample([7.0], "e"))]) == 0.0


def test_permutations_of_many_runs_are_drawn_and_always_the_same() -> None:
    rng = np.random.default_rng(4)
    first, second = rng.normal(0.4, 1, 32), rng.normal(0, 1, 32)
    drawn, again = (permutation_p([(first, second)]) for _ in range(2))
    assert drawn == again
    assert drawn == pytest.approx(stats.ttest_ind(first, second).pvalue, abs=0.02)


def test_pairs_agree_with_scipy_and_flip_signs_without_spread() -> None:
    rng = np.random.default_rng(5)
    seeds = rng.normal(0, 5, 8)
    first, second = (pd.Series(seeds + rng.normal(mean, 1, 8)) for mean in (1.0, 0.0))
    ours, theirs = paired(first, second), stats.ttest_rel(first, second)
    interval = theirs.confidence_interval()
    expected = [theirs.statistic, theirs.pvalue, interval.low, interval.high]
    np.testing.assert_allclose([ours.t, ours.p, ours.low, ours.high], expected)
    equal = paired(pd.Series([2.0, 3.0, 4.0, 5.0]), pd.Series([1.0, 2.0, 3.0, 4.0]))
    assert (equal.method, equal.p) == (Method.SIGN_FLIP, pytest.approx(2 / 2**4))
    assert math.isnan(equal.low)
    drawn = sign_flip_p(first - second + rng.normal(0, 0.01, 8))
    assert drawn == pytest.approx(stats.wilcoxon(first - second).pvalue, abs=0.05)


@pytest.mark.parametrize(
    ("first", "second", "reason"),
    [
        ([1.0], [2.0, 3.0], "needs 2 seeds"),
        ([], [2.0, 3.0], "needs 2 seeds"),
        ([1.0, math.nan], [2.0, 3.0], "needs 2 seeds"),
        ([0.0, 0.0], [0.0, 0.0, 0.0], "no spread between seeds"),
    ],
)
def test_no_p_value_without_a_test(first: list[float], second: list[float], reason: str) -> None:
    result = welch(sample(first, "a"), sample(second, "b"))
    assert result.reason == reason
    assert math.isnan(result.p)
    assert not result.significant


def test_a_run_is_never_compared_with_itself() -> None:
    runs = sample([1.0, 2.0, 3.0], "run")
    assert welch(runs, runs + 100).reason == "same runs"
    assert welch(runs, sample([5.0, 6.0, 7.0], "run").iloc[2:]).reason == "same runs"


def test_describe_by_hand() -> None:
    result = describe([2.0, 4.0, 9.0, math.nan])
    assert result.n == 3
    assert result.mean == 5
    assert result.std == pytest.approx(math.sqrt((9 + 1 + 16) / 2))
    assert result.standard_error == pytest.approx(math.sqrt(13 / 3))
    one = describe([7.0])
    assert (one.n, one.mean) == (1, 7.0)
    assert np.isnan([one.std, one.standard_error]).all()


@given(st.floats(1e-6, 100 - 1e-6), st.floats(0, 300))
def test_the_interval_of_a_percentage_stays_within_its_bounds(mean: float, margin: float) -> None:
    low, high = percent_interval(mean, margin)
    assert 0 <= low <= mean * (1 + 1e-9)
    assert mean * (1 - 1e-9) <= high <= 100
    assert percent_interval(100 - mean, margin) == pytest.approx((100 - high, 100 - low), abs=1e-4)


def test_the_interval_of_a_percentage_by_hand() -> None:
    # The share 1/4 is at the angle of 30 degrees, where a point is 1 / (100 sin 60) radians.
    low, high = percent_interval(25.0, 100 * math.sin(math.pi / 3) * math.pi / 12)
    assert (low, high) == pytest.approx((100 * math.sin(math.pi / 12) ** 2, 50.0))
    assert percent_interval(25.0, 0.01) == pytest.approx((24.99, 25.01), abs=1e-5)
    # At its bounds it is cut.
    assert percent_interval(0.0, 3.0) == (0.0, 3.0)
    assert percent_interval(100.0, 3.0) == (97.0, 100.0)
    assert np.isnan(percent_interval(10.0, math.nan)).all()
    assert np.isnan(percent_interval(0.0, math.nan)).all()


def test_holm_by_hand() -> None:
    # Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1, never falling.
    adjusted = holm([0.01, 0.04, 0.03, math.nan, 0.005])
    np.testing.assert_allclose(adjusted, [0.03, 0.06, 0.06, math.nan, 0.02])


def test_holm_on_his_own_condition() -> None:
    # Holm (1979): the k-th smallest of n is set against alpha / (n - k + 1), until one fails.
    p_values = np.array([0.012, 0.020, 0.024, 0.009, 0.30])
    rejected = set()
    for k, index in enumerate(np.argsort(p_values)):
        if p_values[index] > 0.05 / (len(p_values) - k):
            break
        rejected.add(int(index))
    # 0.024 would pass alone, under 0.05 / 2, but comes after 0.020, which fails.
    assert rejected == {0, 3}
    assert set(np.flatnonzero(holm(p_values) <= 0.05).tolist()) == rejected


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_lies_between_p_and_bonferroni(values: list[float]) -> None:
    adjusted = holm(values)
    assert np.all(adjusted >= np.array(values) - 1e-12)
    assert np.all(adjusted <= np.minimum(1, len(values) * np.array(values)) + 1e-12)


VALUES = {"adr": [1, 9, 4, 30], "alp_gmm": [40, 44, 39, 52], "random": [20, 25, 18, 11]}


@pytest.mark.parametrize("reference", [None, "random"])
def test_statistics_give_the_tests_that_runs_give(reference: str | None) -> None:
    runs = pool(*cells(VALUES), *cells(VALUES, expert_knowledge="high"))
    expected = pairwise(runs, "mastered_percent", reference)
    found = pairwise_from_statistics(pooled(runs), reference=reference)
    same = ["expert_knowledge", "first", "second", "n", "reference_n", "difference", "p", "holm", "reason"]
    pd.testing.assert_frame_equal(found[same], expected[same])


def test_the_papers_random_is_beaten_as_it_says() -> None:
    tests = pairwise_from_statistics(paper_frame(), reference="random")
    tests = tests[tests["challenge"] != "original"]
    worse = tests[(tests["p"] < 0.05) & (tests["difference"] < 0)]
    # Section 5: SPDL is significantly worse in 11 of 15; GoalGAN at low is better on one challenge only.
    assert (worse["first"] == "spdl").sum() == 11
    better = tests[(tests["p"] < 0.05) & (tests["difference"] > 0) & (tests["expert_knowledge"] == "low")]
    assert better.loc[better["first"] == "goal_gan", "challenge"].tolist() == ["mostly_trivial"]


def test_why_there_is_no_test() -> None:
    table = pd.DataFrame({"teacher": ["adr", "spdl"], "n": [1, 4]})
    table = table.assign(mastered_percent_mean=[1.0, 2.0], mastered_percent_std=[np.nan, 1.0])
    assert pairwise_from_statistics(table)["reason"].tolist() == ["needs 2 seeds"]
    alone = pairwise_from_statistics(table, reference="random")
    assert set(alone["reason"]) == {"no Random to compare with"}
    assert pairwise_from_statistics(table.head(0)).empty
