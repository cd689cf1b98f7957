"""What a planned experiment can show."""

from __future__ import annotations

import math

import pandas as pd
import pytest
from rich.console import Console
from scipy import stats
from synthetic_pools import cell, pool

from analysis.baselines import find_baseline
from analysis.commands.rankings import show_detectable_differences
from analysis.comparisons.planning import detectable_differences, plans_against_random
from analysis.measures.pooling import runs_after
from analysis.measures.tested import HEADLINE, PAPERS
from analysis.statistics import Description
from analysis.statistics.power import detectable_difference
from tma_ray.benchmark import paper_results

STEPS = 20_000_000


def rows(challenge: str, seeds: int, *teachers: str, level: str = "none") -> list[dict[str, str]]:
    cell = {"environment": "stump_tracks", "challenge": challenge, "expert_knowledge": level}
    return [cell | {"teacher": teacher} for teacher in teachers for _ in range(seeds)]


def test_a_difference_is_found_with_80_percent_power() -> None:
    """Against the noncentral t distribution of two groups of equal size and spread."""
    (found,) = detectable_differences(rows("mostly_unfeasible", 32, "random", "riac"), STEPS).itertuples()
    spread = [
        r.std for r in paper_results() if r.challenge == found.challenge and r.expert_knowledge == "none"
    ]
    assert found.seeds == 32
    assert found.steadiest < found.typical < found.most_varied
    critical = stats.t.isf(0.025, 62)
    shift = found.most_varied / (max(spread) * math.sqrt(2 / 32))
    assert stats.nct.sf(critical, 62, shift) == pytest.approx(0.8, abs=1e-3)


def test_doubtful_entries_and_parts_of_a_pool_are_left_out() -> None:
    parkour = [
        {"environment": "parkour", "challenge": "original", "expert_knowledge": "low", "teacher": "adr"}
        for _ in range(48)
    ]
    (found,) = detectable_differences(parkour, STEPS).itertuples()
    assert found.seeds == 48
    assert 8 < found.steadiest < found.most_varied < 20
    (trivial,) = detectable_differences(rows("mostly_trivial", 32, "random"), STEPS).itertuples()
    assert trivial.typical == detectable_differences(rows("mostly_trivial", 32, "riac"), STEPS)["typical"][0]


def test_what_is_not_known_is_a_dash() -> None:
    table = detectable_differences(
        [*rows("easy", 5, "random"), *rows("rugged_difficulty", 1, "random")], STEPS
    )
    assert table["typical"].isna().all()
    assert detectable_differences([], STEPS).empty
    console = Console(record=True, width=120)
    show_detectable_differences(rows("rugged_difficulty", 1, "random"), STEPS, console)
    assert "rugged_difficulty      1" in console.export_text()


def test_the_group_with_the_fewest_seeds_counts() -> None:
    both = [*rows("mostly_trivial", 8, "riac"), *rows("mostly_trivial", 3, "adr", level="low")]
    assert detectable_differences(both, STEPS)["seeds"].tolist() == [3]


def test_a_lite_budget_has_the_spread_of_lite_runs() -> None:
    runs = runs_after(find_baseline("lite-1").frames(), training=False)
    runs = runs[runs["challenge"] == "mostly_unfeasible"]
    seeds = runs.groupby("teacher")[HEADLINE].transform("size")
    spreads = sorted(runs[seeds == 5].groupby("teacher")[HEADLINE].std())
    planned = rows("mostly_unfeasible", 5, "random", "riac")
    (found,) = detectable_differences(planned, 2_000_000).itertuples()
    largest = Description(5, 0.0, spreads[-1])
    assert found.spread_of == "lite-1"
    assert found.most_varied == pytest.approx(detectable_difference(largest, largest))
    (longer,) = detectable_differences(planned, 7_000_000).itertuples()
    assert longer.spread_of == "paper"
    assert longer.typical != found.typical
    parkour = [planned[0] | {"environment": "parkour", "challenge": "original"}] * 3
    assert detectable_differences(parkour, 2_000_000)["spread_of"].tolist() == ["paper"]


def test_a_plan_says_the_runs_and_hours_that_would_find_the_difference_seen() -> None:
    """Two challenges, three runs each, of which one side or the other takes two hours."""
    values = {"random": [10.0, 20.0, 30.0], "adr": [14.0, 24.0, 34.0], "spdl": [70.0, 80.0, 90.0]}
    runs = pool(
        *(
            cell(teacher, seed, value, challenge=challenge, experiment=challenge)
            for teacher, results in values.items()
            for challenge in ("original", "mostly_trivial")
            for seed, value in enumerate(results)
        )
    )
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
