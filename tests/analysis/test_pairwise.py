import math
from collections.abc import Iterator

import numpy as np
import pytest
from scipy import stats
from synthetic_pools import cell, cells, parkour, pool
from synthetic_results import SyntheticCampaign

from analysis.comparisons.pairwise import OTHER_PARTS, pairwise
from analysis.data.columns import COMPARED
from analysis.data.loading import load
from analysis.data.reference import NO_BASELINE
from analysis.measures.pooling import pool_runs, reuse_random
from analysis.measures.run_measures import evaluations_at
from analysis.statistics import describe, holm
from analysis.statistics.power import detectable_difference

VALUES = {"adr": [1, 9, 4, 30], "alp_gmm": [40, 44, 39, 52], "random": [20, 25, 18, 11]}


def three_teachers(**changes: object) -> Iterator[dict[str, object]]:
    return cells(VALUES, **changes)


def test_all_pairs_agree_with_scipy_and_are_adjusted_together() -> None:
    tests = pairwise(pool(*three_teachers()), "mastered_percent")
    pairs = [("adr", "alp_gmm"), ("adr", "random"), ("alp_gmm", "random")]
    assert list(zip(tests["first"], tests["second"], strict=True)) == pairs
    expected = [stats.ttest_ind(VALUES[a], VALUES[b], equal_var=False).pvalue for a, b in pairs]
    np.testing.assert_allclose(tests["p"], expected)
    np.testing.assert_allclose(tests["holm"], holm(expected))
    differences = [np.mean(VALUES[a]) - np.mean(VALUES[b]) for a, b in pairs]
    assert tests["difference"].tolist() == pytest.approx(differences)
    wanted = [detectable_difference(describe(VALUES[a]), describe(VALUES[b])) for a, b in pairs]
    np.testing.assert_allclose(tests["detectable"], wanted)


def test_intervals_of_a_family_hold_together_and_agree_with_holm() -> None:
    tests = pairwise(pool(*three_teachers()), "mastered_percent")
    for test in tests.to_dict("records"):
        error = test["difference"] / test["t"]
        margin = stats.t.ppf(1 - 0.05 / 2 / len(tests), test["degrees_of_freedom"]) * error
        found = test["holm"] < 0.05
        inner = 0.0 if found else -math.inf
        sign = math.copysign(1.0, test["difference"])
        near, far = sorted((test["simultaneous_low"], test["simultaneous_high"]), key=abs)
        assert max(abs(near), abs(far)) == pytest.approx(abs(test["difference"]) + abs(margin))
        assert sign * near >= inner - 1e-12
        assert (test["simultaneous_low"] <= 0 <= test["simultaneous_high"]) == (not found or near == 0)


def test_a_reference_is_set_against_every_other() -> None:
    tests = pairwise(pool(*three_teachers()), "mastered_percent", reference="random")
    assert list(tests["first"]) == ["adr", "alp_gmm"]
    assert set(tests["second"]) == {"random"}
    np.testing.assert_allclose(tests["holm"], holm(tests["p"]))


def test_comparisons_are_families_of_their_own() -> None:
    runs = pool(*three_teachers(), *three_teachers(challenge="mostly_trivial"))
    tests = pairwise(runs, "mastered_percent")
    assert tests.groupby("challenge")["p"].size().to_dict() == {"mostly_trivial": 3, "original": 3}
    alone = pairwise(pool(*three_teachers()), "mastered_percent")
    np.testing.assert_allclose(tests[tests["challenge"] == "original"]["holm"], alone["holm"])


def test_levels_of_a_teacher_that_share_their_runs_are_not_tested() -> None:
    runs = [
        cell("alp_gmm", seed, value, expert_knowledge=level, run_id=f"{run}{seed}")
        for level, run in (("none", "same"), ("low", "same"), ("high", "own"))
        for seed, value in enumerate([10, 20, 33])
    ]
    within = [*(column for column in COMPARED if column != "expert_knowledge"), "teacher"]
    tests = pairwise(pool(*runs), "mastered_percent", within=within, between="expert_knowledge")
    reasons = {frozenset(pair): reason for *pair, reason in tests[["first", "second", "reason"]].to_numpy()}
    assert reasons.pop(frozenset({"none", "low"})) == "same runs"
    assert reasons == dict.fromkeys((frozenset({"none", "high"}), frozenset({"low", "high"})), "")
    untested = tests[tests["reason"] != ""]
    assert untested[["p", "holm", "detectable"]].isna().all(axis=None)
    against_none = pairwise(pool(*runs), "mastered_percent", "none", within, "expert_knowledge")
    assert list(against_none["first"]) == ["high", "low"]


def test_pools_of_other_bodies_are_not_tested() -> None:
    whole = parkour("random", {"classic_bipedal": [30, 50], "fish": [0, 60], "climbing_chimpanzee": [0, 1]})
    part = parkour("adr", {"classic_bipedal": [70, 80]})
    test = pairwise(pool(*whole, *part), "mastered_percent").iloc[0]
    assert (test["reason"], test["n"], test["reference_n"]) == (OTHER_PARTS, 2, 6)
    assert math.isnan(test["p"])


def test_runs_without_the_measure_are_counted_apart() -> None:
    late = cell("adr", 9, math.nan, status="running")
    test = pairwise(pool(*three_teachers(), late), "mastered_percent", reference="random").iloc[0]
    assert (test["first"], test["n"], test["uncounted"]) == ("adr", 4, 1)


def test_without_its_reference_nothing_is_tested() -> None:
    runs = pool(cell("adr", 0, 1), cell("adr", 1, 2))
    test = pairwise(runs, "mastered_percent", reference="random").iloc[0]
    assert (test["first"], test["second"], test["n"], test["reason"]) == ("adr", "random", 2, NO_BASELINE)
    other = pairwise(runs, "mastered_percent", reference="spdl").iloc[0]
    assert other["reason"] == "no spdl to compare with"


def test_single_seeds_are_not_tested() -> None:
    test = pairwise(pool(cell("adr", 0, 1), cell("random", 0, 5)), "mastered_percent").iloc[0]
    assert (test["reason"], test["difference"]) == ("needs 2 seeds", -4)
    assert math.isnan(test["holm"])


def test_random_lent_to_a_level_is_tested_there_and_not_against_itself() -> None:
    none, high = {"random": [0, 1, 2]}, {"adr": [0, 2, 4]}
    runs = pool(*cells(none, expert_knowledge="none"), *cells(high, expert_knowledge="high"))
    tests = pairwise(reuse_random(runs), "mastered_percent", reference="random")
    assert tests[["expert_knowledge", "first", "reason"]].to_numpy().tolist() == [["high", "adr", ""]]


def test_tests_along_learning_curves(campaign: SyntheticCampaign) -> None:
    for seed in range(3):
        few, many = [300] * seed + [0] * (9 - seed), [300] * (seed + 6) + [0] * (3 - seed)
        campaign.plain_run("random", seed, {0: [0] * 9, 500: few, 1000: few})
        half = {0: [0] * 9, 500: few}
        campaign.plain_run("adr", seed, half | {1000: many} if seed else half, "done" if seed else "running")
    frames = load(campaign.root)
    runs = pool_runs(frames.cells, evaluations_at(frames, [0, 500, 1000]))
    tests = pairwise(runs, "mastered_percent", within=[*COMPARED, "step"]).set_index("step")
    assert tests["reason"].to_dict() == {0: "no spread between seeds", 500: "", 1000: ""}
    assert tests["n"].to_dict() == {0: 3, 500: 3, 1000: 2}
    assert tests["uncounted"].to_dict() == {0: 0, 500: 0, 1000: 1}
    assert tests.loc[500, "p"] == pytest.approx(1)
    last = [100 * k / 9 for k in (7, 8)], [100 * k / 9 for k in (0, 1, 2)]
    assert tests.loc[1000, "p"] == pytest.approx(stats.ttest_ind(*last, equal_var=False).pvalue)
    # Two tests are one family: that of the last step is doubled.
    assert tests.loc[1000, "holm"] == pytest.approx(2 * tests.loc[1000, "p"])


def test_empty_tables_have_their_columns() -> None:
    nothing = pool(cell("adr", 0, 1)).head(0)
    table = pairwise(nothing, "mastered_percent", reference="random")
    assert table.empty
    assert {"first", "second", "p", "holm", "detectable", "reason"} < set(table.columns)
    assert pairwise(pool(cell("adr", 0, 1)), "mastered_percent").empty
