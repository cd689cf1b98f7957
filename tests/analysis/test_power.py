"""Power of tests, and what a planned experiment can show."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from synthetic_pools import cells, pool
from views import printed

from analysis.baselines import find_baseline
from analysis.commands.rankings import show_detectable_differences
from analysis.comparisons.planning import detectable_differences, plans_against_random
from analysis.measures.pooling import runs_after
from analysis.measures.tested import HEADLINE, PAPERS
from analysis.statistics import Comparison, Description, Method, welch_from_statistics
from analysis.statistics.power import detectable_difference, detectable_in_pairs, power, seeds_needed
from tma_ray.benchmark import paper_results


def seeds(n: int, std: float = 1.0) -> Description:
    return Description(n, math.nan, std)


@pytest.mark.parametrize(("effect", "published"), [(0.2, 393.41), (0.5, 63.77), (0.8, 25.52)])
def test_seeds_needed_as_published(effect: float, published: float) -> None:
    # What R's power.t.test needs a group for power 0.8; Cohen (1992) has 393, 64 and 26.
    fewer, enough = (power(effect, seeds(n), seeds(n)) for n in (math.floor(published), math.ceil(published)))
    assert fewer < 0.8 < enough
    assert fewer + (enough - fewer) * (published % 1) == pytest.approx(0.8, abs=1e-3)


@pytest.mark.parametrize(
    ("n", "std", "difference", "error"),
    [
        (64, 10.0, 5.0, 0.03),  # a medium effect
        (1600, 1.0, 0.1, 0.002),  # 16 s^2 / d^2 a group, Lehr's rule, for many
        (3, 10.0, 35.1, 0.1),  # found by simulation of Welch's test, of which few seeds show less
        (2, 10.0, 104, 1),
    ],
)
def test_the_smallest_difference_as_published(n: int, std: float, difference: float, error: float) -> None:
    assert detectable_difference(seeds(n, std), seeds(n, std)) == pytest.approx(difference, abs=error)


@pytest.mark.parametrize("significance", [0.05, 0.01])
def test_without_a_difference_power_is_how_often_welch_errs(significance: float) -> None:
    # Welch's test errs less often than it promises with few seeds, and as often with many.
    assert power(0.0, seeds(2), seeds(2), significance) < 0.7 * significance
    assert power(0.0, seeds(400), seeds(300, 3.0), significance) == pytest.approx(significance, rel=0.01)
    # And finds less than Student's would: this by simulation.
    assert power(30.7, seeds(3, 10.0), seeds(3, 10.0)) == pytest.approx(0.70, abs=0.005)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (seeds(3), seeds(3)),
        (seeds(32, 6.6), seeds(32, 10.5)),
        (seeds(16, 28.5), seeds(16, 0.0)),
        (seeds(8, 20.0), seeds(48, 5.0)),
    ],
)
def test_power_by_simulation(first: Description, second: Description) -> None:
    # The standard deviations here are of the populations; each experiment estimates its own.
    rng, repeats = np.random.default_rng(3), 4_000
    difference = detectable_difference(first, second)
    samples = rng.normal(difference, first.std, (repeats, first.n))
    others = rng.normal(0.0, second.std, (repeats, second.n))
    found = stats.ttest_ind(samples, others, axis=1, equal_var=False).pvalue < 0.05
    assert found.mean() == pytest.approx(0.8, abs=0.025)


def test_more_seeds_show_smaller_differences() -> None:
    found = [detectable_difference(seeds(n, 10.0), seeds(n, 10.0)) for n in (2, 3, 5, 10, 32, 48, 1000)]
    assert found == sorted(found, reverse=True)


@settings(max_examples=30)
@given(st.tuples(st.integers(2, 60), st.floats(0.01, 50)), st.tuples(st.integers(2, 60), st.floats(0, 50)))
def test_every_pair_has_a_smallest_difference(first: tuple[int, float], second: tuple[int, float]) -> None:
    groups = seeds(*first), seeds(*second)
    difference = detectable_difference(*groups)
    assert power(difference, *groups) == pytest.approx(0.8, abs=1e-6)
    assert power(100 * difference, *groups) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (seeds(1), seeds(32)),
        (seeds(32), seeds(0)),
        (seeds(32, math.nan), seeds(32)),
        (seeds(32, 0.0), seeds(32, 0.0)),
    ],
)
def test_where_nothing_can_be_tested_nothing_can_be_shown(first: Description, second: Description) -> None:
    assert math.isnan(power(1.0, first, second))
    assert math.isnan(detectable_difference(first, second))


@pytest.mark.parametrize("wanted", [0.05, 1.0, 80.0])
def test_power_is_a_probability_over_the_significance(wanted: float) -> None:
    with pytest.raises(ValueError, match="expected over the significance"):
        detectable_difference(seeds(32), seeds(32), wanted)


def test_seeds_needed_are_those_that_the_power_asks_for() -> None:
    few, spread = 5, 10.0
    first, second = Description(few, 6.0, spread), Description(few, 0.0, spread)
    needed = seeds_needed(welch_from_statistics(first, second), few)
    assert needed is not None
    assert abs(power(6.0, seeds(needed, spread), seeds(needed, spread)) - 0.8) < 0.01
    paired = Comparison(few, few, 6.0, t=6.0 / (spread / math.sqrt(few)), degrees_of_freedom=few - 1)
    needed = seeds_needed(paired, few)
    assert needed is not None
    margins = {n: stats.t.ppf(0.975, n - 1) * spread / math.sqrt(n) for n in (needed - 1, needed)}
    less, enough = (detectable_in_pairs(n, margin) for n, margin in margins.items())
    assert enough <= 6.0 < less


def test_no_number_of_seeds_is_said_where_none_is_known() -> None:
    tiny = welch_from_statistics(Description(5, 0.01, 10.0), Description(5, 0.0, 10.0))
    assert seeds_needed(tiny, 5) is None
    assert seeds_needed(tiny, 1) is None
    assert seeds_needed(Comparison(3, 3, 5.0, p=0.1, method=Method.PERMUTATION), 3) is None


def budget(steps: int) -> dict[str, int]:
    return dict.fromkeys(("stump_tracks", "parkour"), steps)


STEPS = budget(20_000_000)


def rows(
    challenge: str, seeds: int, *teachers: str, level: str = "none", environment: str = "stump_tracks"
) -> list[dict[str, str]]:
    cell = {"environment": environment, "challenge": challenge, "expert_knowledge": level}
    return [cell | {"teacher": teacher} for teacher in teachers for _ in range(seeds)]


def test_a_difference_is_found_with_80_percent_power() -> None:
    """Against the noncentral t distribution of two groups of equal size and spread."""
    (found,) = detectable_differences(rows("mostly_unfeasible", 32, "random", "riac"), STEPS).itertuples()
    there = [r for r in paper_results() if r.challenge == found.challenge]
    spread = [r.std for r in there if r.expert_knowledge == "none"]
    assert found.seeds == 32
    assert found.steadiest < found.typical < found.most_varied
    critical = stats.t.isf(0.025, 62)
    shift = found.most_varied / (max(spread) * math.sqrt(2 / 32))
    assert stats.nct.sf(critical, 62, shift) == pytest.approx(0.8, abs=1e-3)


def test_doubtful_entries_and_parts_of_a_pool_are_left_out() -> None:
    parkour = rows("original", 48, "adr", level="low", environment="parkour")
    (found,) = detectable_differences(parkour, STEPS).itertuples()
    assert found.seeds == 48
    assert 8 < found.steadiest < found.most_varied < 20
    (trivial,) = detectable_differences(rows("mostly_trivial", 32, "random"), STEPS).itertuples()
    assert trivial.typical == detectable_differences(rows("mostly_trivial", 32, "riac"), STEPS)["typical"][0]


def test_what_is_not_known_is_a_dash() -> None:
    both = [*rows("easy", 5, "random"), *rows("rugged_difficulty", 1, "random")]
    table = detectable_differences(both, STEPS)
    assert table["typical"].isna().all()
    assert detectable_differences([], STEPS).empty
    shown = printed(show_detectable_differences, rows("rugged_difficulty", 1, "random"), STEPS, width=120)
    assert "rugged_difficulty      1" in shown


def test_the_group_with_the_fewest_seeds_counts() -> None:
    both = [*rows("mostly_trivial", 8, "riac"), *rows("mostly_trivial", 3, "adr", level="low")]
    assert detectable_differences(both, STEPS)["seeds"].tolist() == [3]


@pytest.mark.parametrize(
    ("release", "student"), [("lite-1", "ppo"), ("lite-2", "ppo:preset=decisive"), ("lite-1", "sac")]
)
def test_a_lite_budget_has_the_spread_of_lite_runs(release: str, student: str) -> None:
    runs = runs_after(find_baseline(release).frames(), training=False)
    runs = runs[runs["challenge"] == "mostly_unfeasible"]
    seeds = runs.groupby("teacher")[HEADLINE].transform("size")
    spreads = sorted(runs[seeds == 5].groupby("teacher")[HEADLINE].std())
    planned = [row | {"student": student} for row in rows("mostly_unfeasible", 5, "random", "riac")]
    (found,) = detectable_differences(planned, budget(2_000_000)).itertuples()
    largest = Description(5, 0.0, spreads[-1])
    assert found.spread_of == release
    assert found.most_varied == pytest.approx(detectable_difference(largest, largest))
    (longer,) = detectable_differences(planned, budget(7_000_000)).itertuples()
    assert longer.spread_of == "paper"
    assert longer.typical != found.typical
    parkour = rows("original", 3, "random", environment="parkour")
    assert detectable_differences(parkour, budget(2_000_000))["spread_of"].tolist() == ["paper"]


def test_a_plan_says_the_runs_and_hours_that_would_find_the_difference_seen() -> None:
    """Two challenges, three runs each, of which one side or the other takes two hours."""
    values = {"random": [10.0, 20.0, 30.0], "adr": [14.0, 24.0, 34.0], "spdl": [70.0, 80.0, 90.0]}
    places = ({"challenge": name, "experiment": name} for name in ("original", "mostly_trivial"))
    runs = pool(*(row for place in places for row in cells(values, **place)))
    hours = pd.Series(2.0, index=runs["run_id"].unique())
    (text,) = plans_against_random(runs, ["adr", "spdl"], hours, PAPERS)  # of spdl nothing is open
    assert text.startswith("If the true difference between ADR and Random is the 4.0 points seen here, a new")
    needed = int(text.partition("with ")[2].partition(" runs")[0])
    wanted = stats.norm.isf(0.025) + stats.norm.isf(0.2)
    assert needed == pytest.approx(2 * 10**2 / 2 * (wanted / 4) ** 2, abs=2)  # standard error: 10 / root n
    assert f"each of the 2 challenges, about {needed * 2 * 4} hours of runs, finds it" in text
    assert "Fix that number before the first run" in text
    assert "hours" not in plans_against_random(runs, ["adr"], pd.Series(dtype=float))[0]
    assert plans_against_random(runs.head(0), ["adr"], hours) == []
