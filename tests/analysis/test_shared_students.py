"""Results of simulated students, which all teachers of a seed share, are paired by seed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic_pools import cell, cells, pool

from analysis.comparisons.aggregates import improvements, interquartile_means, profiles, stratified_means
from analysis.comparisons.pairwise import over_challenges, pairwise
from analysis.comparisons.ranks import ranks
from analysis.data.columns import ACROSS, STRATA
from analysis.measures.tested import compared, mean_over_strata, seeds_to_pair
from analysis.statistics import Method, Scale, paired_strata, percent_interval
from analysis.statistics.estimates import interquartile_mean_of, performance_profile
from analysis.statistics.power import detectable_in_pairs
from analysis.statistics.tests import FEW_PAIRS
from tma_ray.results import CHIPMUNK, SIMULATED

PLACES = ("original", "mostly_trivial", "rugged_difficulty")

PACES = [30.0, 19.0, 11.0, 5.0, 2.0]
"""What the students of five seeds add to the mastered tasks of every teacher."""


def results(values: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Return pooled runs: a teacher's values of seeds 0, 1, …, the same on each challenge but for noise."""
    rng = np.random.default_rng(1)
    rows = (
        cell(teacher, seed, value + round(float(rng.normal()), 3), challenge=place, engine=SIMULATED)
        for teacher, numbers in values.items()
        for place in PLACES
        for seed, value in enumerate(numbers)
    )
    return pool(*rows)


def of(runs: pd.DataFrame, teacher: str, place: str) -> pd.Series:
    mine = runs[(runs["teacher"] == teacher) & (runs["challenge"] == place)]
    return mine.set_index("seed")["mastered_percent"]


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    return results({"random": PACES, "adr": [pace + 4 for pace in PACES]})


def test_pairs_of_a_challenge_agree_with_scipy(runs: pd.DataFrame) -> None:
    both = (runs, runs.assign(engine=CHIPMUNK))
    table, apart = (pairwise(each, "mastered_percent", "random").set_index("challenge") for each in both)
    for place in PLACES:
        theirs = stats.ttest_rel(of(runs, "adr", place), of(runs, "random", place))
        row = table.loc[place]
        assert (row["method"], row["n"], row["reference_n"]) == (Method.PAIRED, 5, 5)
        assert (row["t"], row["p"]) == pytest.approx((theirs.statistic, theirs.pvalue))
        assert row["detectable"] < 10 < apart.loc[place, "detectable"]
        assert apart.loc[place, "method"] == Method.WELCH


def test_arcsines_by_hand_and_of_percentages_only() -> None:
    found = Scale.ARCSINE.of(pd.Series([0.0, 25.0, 50.0, 100.0 + 1e-12]))
    assert found.tolist() == pytest.approx([0, math.pi / 6, math.pi / 4, math.pi / 2])
    with pytest.raises(ValueError, match="120: expected percentages"):
        Scale.ARCSINE.of(pd.Series([10.0, 120.0]))


def test_over_challenges_a_seed_counts_once(runs: pd.DataFrame) -> None:
    row = over_challenges(runs, "mastered_percent", "random").iloc[0]
    means = [sum(of(runs, teacher, place) for place in PLACES) / 3 for teacher in ("adr", "random")]
    theirs = stats.ttest_rel(*means)
    assert (row["method"], row["n"], row["fewest"], row["challenges"]) == (Method.PAIRED, 5, 5, 3)
    assert (row["difference"], row["p"]) == pytest.approx(((means[0] - means[1]).mean(), theirs.pvalue))
    mean = stratified_means(runs, "mastered_percent").set_index("teacher").loc["random"]
    interval = percent_interval(means[1].mean(), stats.t.ppf(0.975, 4) * stats.sem(means[1]))
    assert mean["n"] == 15
    assert (mean["low"], mean["high"]) == pytest.approx(interval)


def test_a_teacher_is_ranked_on_the_seeds_that_others_have_too() -> None:
    best = [pace + 20 for pace in PACES]
    runs = results({"random": PACES, "adr": best, "riac": [best[0] - 8, best[1] - 8]})
    found = {each.teacher: each for each in ranks(runs)}
    # By plain means RIAC would lead: its two seeds have quick students on average.
    assert found["riac"].mean > found["adr"].mean
    assert (found["adr"].rank, found["riac"].rank, found["random"].rank) == (1, 2, 3)


def test_improvement_is_told_on_common_seeds() -> None:
    runs = results({"random": [0.0, 50.0, 80.0, 90.0], "adr": [10.0, 60.0]})
    row = improvements(runs, "mastered_percent", within=ACROSS, strata=STRATA).iloc[0]
    assert (row["first"], row["n"], row["value"]) == ("adr", 12, pytest.approx(0.75))
    others = improvements(runs.assign(engine=CHIPMUNK), "mastered_percent", within=ACROSS, strata=STRATA)
    assert others["value"].iloc[0] < 0.5


def test_what_depends_on_the_seed_widens_intervals_over_challenges(runs: pd.DataFrame) -> None:
    by = [*ACROSS, "teacher"]
    apart = runs.assign(engine=CHIPMUNK)
    for function in (
        lambda table: interquartile_means(table, "mastered_percent", by, STRATA),
        lambda table: profiles(table, "mastered_percent", [10.0], by, STRATA),
        lambda table: stratified_means(table, "mastered_percent"),
    ):
        widths = [(each["high"] - each["low"]).to_numpy() for each in map(function, (runs, apart))]
        assert (widths[0] > 1.3 * widths[1]).all()


def test_intervals_hold_for_students_that_are_the_same_everywhere() -> None:
    rng, held, draws, seeds = np.random.default_rng(2), np.zeros(2), 600, 8
    index = [[f"{place} {seed}" for seed in range(seeds)] for place in range(6)]
    seed_of = {name: int(name.split()[1]) for names in index for name in names}
    for _ in range(draws):
        paces = rng.normal(0, 1, seeds)
        samples = [pd.Series(paces + rng.normal(0, 0.7, seeds), index=names) for names in index]
        found = mean_over_strata(samples, [1.0] * 6, seed_of)
        middle = interquartile_mean_of(dict(zip("abcdef", samples, strict=True)), seed_of)
        held += [each.low <= 0 <= each.high for each in (found, middle)]
    assert (held / draws >= 0.925).all()
    assert (held / draws <= 0.985).all()


def test_single_runs_as_clusters_change_nothing() -> None:
    sample = {"one": pd.Series([3.0, 8.0, 9.0], index=list("abc"))}
    alone, clustered = (interquartile_mean_of(sample, seeds) for seeds in (None, {"a": 0, "b": 1, "c": 2}))
    assert (clustered.low, clustered.high) == pytest.approx((alone.low, alone.high))
    profile = performance_profile(sample, [5.0]), performance_profile(sample, [5.0], {"a": 0, "b": 1, "c": 2})
    pd.testing.assert_frame_equal(*profile)


def test_pairs_that_cannot_be_tested_say_why() -> None:
    seeds = {"a": 0, "b": 1, "c": 2, "d": 3, "e": 0, "f": 1}
    first, second = pd.Series([1.0, 2.0], index=["a", "b"]), pd.Series([3.0, 5.0], index=["c", "d"])
    assert compared(first, second, seeds).reason == FEW_PAIRS
    assert compared(first.head(1), second, seeds).reason == "needs 2 seeds"
    assert compared(first, first, seeds).reason == "same runs"
    same = pd.Series([1.0, 2.0], index=["e", "f"])
    assert compared(first, same, seeds).reason == "no spread between seeds"
    assert paired_strata([], [], seeds).reason == "nothing in common"
    assert compared(first, second, {}).method is Method.WELCH
    assert compared(first, second, {"a": 0, "b": 1}).method is Method.WELCH


def test_only_engines_whose_seeds_share_a_student_are_paired(runs: pd.DataFrame) -> None:
    assert len(seeds_to_pair(runs)) == 30
    assert seeds_to_pair(runs.assign(engine=CHIPMUNK), runs.head(0)) == {}


@pytest.mark.parametrize(("effect", "published"), [(0.2, 198.15), (0.5, 33.37), (0.8, 14.30)])
def test_pairs_needed_as_published(effect: float, published: float) -> None:
    # What R's power.t.test(type = "paired") needs for power 0.8 and a standard deviation of 1.
    for pairs, enough in ((math.floor(published), False), (math.ceil(published), True)):
        margin = stats.t.ppf(0.975, pairs - 1) / math.sqrt(pairs)
        assert (detectable_in_pairs(pairs, margin) <= effect) == enough
    assert math.isnan(detectable_in_pairs(1, 1.0))
    assert math.isnan(detectable_in_pairs(5, math.nan))


def test_a_variant_of_simulated_students_is_said_once() -> None:
    simulated = {"engine": SIMULATED, "embodiment": "simulated", "student": "simulated"}
    assert set(pool(*cells({"random": [1.0, 1.0]}, **simulated))["variant"]) == {"simulated students"}
