"""Ranks over all challenges: by the mean of equal weights, with what the tests leave open."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic_pools import cell, pool

from analysis.comparisons.aggregates import stratified_means
from analysis.comparisons.boards import Rank, overall, overall_rows, performance_profiles, ranks
from analysis.measures.tested import PAPERS
from analysis.statistics import percent_interval

CHALLENGES = ("original", "mostly_trivial", "rugged_difficulty")


def runs_of(results: dict[str, dict[str, list[float]]]) -> pd.DataFrame:
    return pool(
        *(
            cell(teacher, seed, value, challenge=challenge, experiment=challenge)
            for teacher, challenges in results.items()
            for challenge, values in challenges.items()
            for seed, value in enumerate(values)
        )
    )


def by_teacher(found: list[Rank]) -> dict[str, Rank]:
    return {rank.teacher: rank for rank in found}


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    def around(*means: float) -> dict[str, list[float]]:
        return {name: [m - 1, m, m + 1] for name, m in zip(CHALLENGES, means, strict=False)}

    return runs_of(
        {
            "random": around(10, 10, 10),
            "good": around(30, 40, 50),
            "near": around(31, 39, 49),
            "bad": around(1, 2, 3),
            "part": around(90, 90),
        }
    )


def test_ranks_are_by_the_mean_over_challenges_and_certain_as_far_as_tests_go(runs: pd.DataFrame) -> None:
    found = by_teacher(ranks(runs))
    assert {name: (r.rank, r.of, r.best, r.worst) for name, r in found.items()} == {
        "part": (1, 5, 1, 1),
        "good": (1, 4, 1, 2),
        "near": (2, 4, 1, 2),
        "random": (3, 4, 3, 3),
        "bad": (4, 4, 4, 4),
    }
    good = found["good"]
    assert (good.better, good.worse, good.undecided) == (("random", "bad"), (), ("near",))
    assert good.left_out == ("part",)
    assert [r.teacher for r in ranks(runs)] == ["part", "good", "near", "random", "bad"]


def test_one_teachers_family_is_its_own_pairs(runs: pd.DataFrame) -> None:
    (only,) = ranks(runs, ["near"])
    assert (only.rank, only.best, only.worst) == (2, 1, 2)
    assert "near ranks 2 of 4 by mean, and the tests leave 1 to 2 open" in only.describe()
    assert "lacking challenges: 1 (part)" in only.describe()


def test_who_is_not_ranked_costs_no_power() -> None:
    results = {
        "random": {"original": [10.0, 12.0, 14.0], "mostly_trivial": [10.0, 12.0, 14.0]},
        "near": {"original": [13.7, 14.7, 15.7], "mostly_trivial": [13.2, 14.2, 15.2]},
    }
    (alone,) = ranks(runs_of(results), ["near"])
    more = runs_of({**results, **{f"part{k}": {"original": [1.0, 15.0, 30.0]} for k in range(5)}})
    (beside,) = ranks(more, ["near"])
    assert alone.better == beside.better == ("random",)
    assert len(beside.left_out) == 5
    (whole,) = ranks(runs_of({**results, "other": results["near"]}), ["near"])
    assert whole.better == (), "a second pair of the family takes what was just significant"


def test_the_interval_of_the_mean_has_welch_and_satterthwaites_error() -> None:
    rng = np.random.default_rng(3)
    values = {
        name: list(rng.normal(50, scale, 5)) for name, scale in zip(CHALLENGES, (1, 5, 20), strict=True)
    }
    (row,) = stratified_means(runs_of({"riac": values}), PAPERS).to_dict("records")
    parts = np.array([np.var(each, ddof=1) / 5 / 9 for each in values.values()])
    freedom = parts.sum() ** 2 / (parts**2 / 4).sum()
    margin = stats.t.ppf(0.975, freedom) * np.sqrt(parts.sum())
    mean = np.mean([np.mean(each) for each in values.values()])
    assert row["difference"] == pytest.approx(mean)
    assert (row["low"], row["high"]) == pytest.approx(percent_interval(mean, margin))
    assert (row["challenges"], row["n"]) == (3, 15)


def test_all_challenges_are_those_that_everyone_has(runs: pd.DataFrame) -> None:
    """The results of `part`, which lacks the hardest challenge, are not set beside means over all three."""
    table = overall(runs)
    blocks = {key: rows["teacher"].tolist() for key, rows in table.groupby(["challenges", "of"], sort=False)}
    assert list(blocks) == [(3, 3), (2, 3)]
    assert sorted(blocks[(3, 3)]) == ["bad", "good", "near", "random"]
    assert blocks[(2, 3)][0] == "part"
    assert len(blocks[(2, 3)]) == 5
    good = table[table["teacher"] == "good"].set_index("challenges")
    assert good["mean"].to_dict() == pytest.approx({3: 40.0, 2: 35.0})
    places = [row["place"] for row in overall_rows(runs)]
    assert sum(place.endswith("2 of 3 challenges") for place in places) == 5
    assert [len(rows["teacher"].unique()) for _, rows in performance_profiles(runs)] == [4, 5]


def test_a_mean_over_challenges_weighs_them_alike_whatever_their_bodies() -> None:
    cells = (
        cell("riac", seed, value + seed, challenge=challenge, embodiment=body, experiment=challenge)
        for challenge, body, value in (
            ("original", "classic_bipedal", 10.0),
            ("diverse_students", "short_bipedal", 40.0),
            ("diverse_students", "spider", 60.0),
        )
        for seed in range(3)
    )
    (row,) = overall(pool(*cells)).to_dict("records")
    assert (row["challenges"], row["n"]) == (2, 9)
    assert row["mean"] == pytest.approx((11 + (41 + 61) / 2) / 2)


def test_single_runs_leave_every_rank_open() -> None:
    found = ranks(runs_of({name: {"original": [value]} for name, value in (("random", 1.0), ("riac", 9.0))}))
    assert [(r.teacher, r.rank, r.best, r.worst) for r in found] == [("riac", 1, 1, 2), ("random", 2, 1, 2)]
    assert np.isnan(found[0].low)
    assert ranks(runs_of({"random": {"original": [float("nan")]}})) == []
