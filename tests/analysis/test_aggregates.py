import math

import numpy as np
import pytest
from scipy import stats
from synthetic_pools import cell, cells, parkour, pool

from analysis.comparisons.aggregates import improvements, interquartile_means, profiles
from analysis.comparisons.pairwise import over_challenges
from analysis.data.columns import ACROSS, STRATA
from analysis.data.reference import NO_BASELINE

BODIES = {"classic_bipedal": [30, 50, 41, 38], "fish": [0, 60, 70, 1], "climbing_chimpanzee": [0, 1, 0, 0]}


def test_interquartile_means_of_pools() -> None:
    table = interquartile_means(pool(*parkour("random", BODIES)), "mastered_percent")
    row = table.iloc[0]
    middle = sorted(value for values in BODIES.values() for value in values)[3:9]
    assert (row["value"], row["n"], row["reason"], row["missing"]) == (np.mean(middle), 12, "", "")
    assert row["low"] < row["value"] < row["high"]


def test_across_challenges_each_is_a_stratum() -> None:
    both, trivial = {"adr": [0, 1, 2, 3], "random": [10, 11, 12, 13]}, {"random": [10, 11, 12, 13]}
    runs = pool(*cells(both), *cells(trivial, challenge="mostly_trivial"))
    table = interquartile_means(runs, "mastered_percent", [*ACROSS, "teacher"], STRATA)
    table = table.set_index("teacher")
    assert table["n"].to_dict() == {"adr": 4, "random": 8}
    assert table["value"].to_dict() == {"adr": 1.5, "random": 11.5}
    assert "mostly_trivial" in table.loc["adr", "missing"]
    assert table.loc["random", "missing"] == ""
    pair = improvements(runs, "mastered_percent", within=ACROSS, strata=STRATA).iloc[0]
    assert (pair["reason"], math.isnan(pair["value"])) == ("other strata", True)


def test_a_run_at_several_levels_counts_once() -> None:
    runs = [(s, {"run_id": f"r{s}", "expert_knowledge": at}) for at in ("none", "low") for s in range(4)]
    levels = [cell("random", s, s, **names) for s, names in runs]
    by = [column for column in ACROSS if column != "expert_knowledge"]
    table = interquartile_means(pool(*levels), "mastered_percent", [*by, "teacher"], STRATA)
    assert table["n"].tolist() == [4]


def test_improvement_between_teachers() -> None:
    better = {body: [value + 100 for value in values] for body, values in BODIES.items()}
    runs = pool(*parkour("random", BODIES), *parkour("adr", better))
    pair = improvements(runs, "mastered_percent", reference="random").iloc[0]
    assert (pair["first"], pair["second"], pair["value"], pair["n"]) == ("adr", "random", 1, 24)
    assert 0.5 < pair["low"] < pair["high"] == 1
    assert len(improvements(runs, "mastered_percent")) == 1
    alone = pool(*parkour("adr", BODIES))
    pair = improvements(alone, "mastered_percent", reference="random").iloc[0]
    assert (pair["reason"], math.isnan(pair["value"])) == (NO_BASELINE, True)


def test_profiles_of_teachers() -> None:
    runs = pool(*parkour("random", BODIES), *parkour("adr", {body: [5, 6, 7, 8] for body in BODIES}))
    table = profiles(runs, "mastered_percent", [0, 6, 40]).set_index(["teacher", "threshold"])
    shares = {"adr": (1, 0.5, 0), "random": (8 / 12, 0.5, 4 / 12)}
    assert {name: tuple(table.loc[name, "share"]) for name in shares} == shares
    assert table.index.get_level_values("threshold").tolist() == [0, 6, 40] * 2


def test_unfinished_and_empty_pools_have_no_numbers() -> None:
    runs = pool(*(cell("adr", seed, math.nan, status="running") for seed in range(3)), cell("spdl", 0, 5))
    table = interquartile_means(runs, "mastered_percent").set_index("teacher")
    assert table["reason"].to_dict() == {"adr": "no results", "spdl": "needs 2 seeds"}
    assert table.loc["adr", "missing"] == "classic_bipedal, sac"
    assert profiles(runs, "mastered_percent", [1])["share"].isna().tolist() == [True, False]
    nothing = runs.head(0)
    assert interquartile_means(nothing, "mastered_percent").empty
    assert improvements(nothing, "mastered_percent").empty
    assert profiles(nothing, "mastered_percent", [1]).empty


def spread_out(**teachers: list[float]) -> list[dict[str, object]]:
    """Return cells of two seeds a challenge, whose values are so far over the challenge's own level."""
    levels = {"original": 10, "mostly_trivial": 40, "rugged": 70}
    return [
        cell(teacher, seed, levels[challenge] + gain + spread, challenge=challenge)
        for teacher, gains in teachers.items()
        for challenge, gain in zip(levels, gains, strict=False)
        for seed, spread in enumerate((-1.0, 1.0))
    ]


def test_the_difference_over_challenges_by_hand() -> None:
    runs = pool(*spread_out(random=[0, 0, 0], adr=[6, 9, 0]))
    row = over_challenges(runs, "mastered_percent", "random").iloc[0]
    # Each of the six samples has variance 2 and 2 seeds: a squared error of 1, of which a ninth counts.
    error = math.sqrt(6 / 9)
    assert (row["first"], row["challenges"], row["n"], row["reference_n"]) == ("adr", 3, 6, 6)
    assert row["difference"] == pytest.approx(5)
    assert row["t"] == pytest.approx(5 / error)
    assert row["degrees_of_freedom"] == pytest.approx(6)
    assert row["holm"] == row["p"] < 0.05


def test_the_scatter_of_all_teachers_bounds_that_of_each() -> None:
    values = {"original": (0, 20), "mostly_trivial": (30, 50), "rugged": (60, 80)}
    wide = [cell("riac", s, v, challenge=c) for c, both in values.items() for s, v in enumerate(both)]
    runs = pool(*spread_out(random=[0, 0, 0], adr=[6, 9, 0]), *wide)
    row = over_challenges(runs, "mastered_percent", "random").iloc[0]
    # Variances of a challenge are 2, 2 and 200: at least half of their mean, 34, counts.
    assert (row["first"], row["difference"]) == ("adr", pytest.approx(5))
    assert row["t"] == pytest.approx(5 / math.sqrt(6 * (34 / 2) / 9))


def test_the_difference_of_one_challenge_is_welchs() -> None:
    values = {"classic_bipedal": [30, 50, 41, 38]}
    runs = pool(*parkour("random", values), *parkour("adr", {"classic_bipedal": [35, 52, 60, 41]}))
    row = over_challenges(runs, "mastered_percent", "random").iloc[0]
    theirs = stats.ttest_ind([35, 52, 60, 41], [30, 50, 41, 38], equal_var=False)
    assert (row["t"], row["p"]) == (pytest.approx(theirs.statistic), pytest.approx(theirs.pvalue))


def test_bodies_of_a_challenge_share_its_weight() -> None:
    bodies = {"classic_bipedal": [0.0, 2.0], "fish": [10.0, 12.0]}
    others = {"classic_bipedal": [4.0, 6.0], "fish": [10.0, 12.0]}
    runs = pool(*parkour("random", bodies), *parkour("adr", others), *spread_out(random=[0] * 3, adr=[8] * 3))
    row = over_challenges(runs, "mastered_percent", "random").iloc[0]
    assert row["difference"] == pytest.approx((3 * 8 + (4 + 0) / 2) / 4)


def test_only_challenges_that_both_have_count_and_runs_are_never_compared_with_themselves() -> None:
    runs = pool(*spread_out(random=[0, 0, 0], adr=[6, 9]))
    assert over_challenges(runs, "mastered_percent", "random").iloc[0]["challenges"] == 2
    alone = pool(*spread_out(adr=[6, 9, 0]))
    assert over_challenges(alone, "mastered_percent", "random").iloc[0]["reason"] == NO_BASELINE
    same = runs.assign(run_id=runs["challenge"] + runs["seed"].astype(str))
    assert over_challenges(same, "mastered_percent", "random").iloc[0]["reason"] == "same runs"
