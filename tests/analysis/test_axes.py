"""Both axes together, and mastery for the same number of trained steps."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic_pools import cell, pool

from analysis.baselines import find_baseline
from analysis.comparisons.against_random import against_random
from analysis.comparisons.pairwise import pairwise
from analysis.data.columns import STRATA
from analysis.data.frames import Frames
from analysis.measures.pooling import levels_together, runs_after
from analysis.measures.run_measures import trained_areas, trained_curves, trained_shares
from analysis.measures.tested import TRAINED, Verdict, on_both_axes


@pytest.fixture(scope="module")
def lite() -> Frames:
    return find_baseline("lite-2").frames()


@pytest.fixture(scope="module")
def runs(lite: Frames) -> pd.DataFrame:
    table = runs_after(lite, training=False)
    return table[(table["expert_knowledge"] == "high") & (table["environment"] == "stump_tracks")]


def test_better_without_more_needs_both_axes() -> None:
    said = {pair: on_both_axes(*pair) for pair in itertools.product(Verdict, Verdict)}
    assert [pair for pair, words in said.items() if words == "better"] == [("better", "better")]
    assert [pair for pair, words in said.items() if words == "worse"] == [("worse", "worse")]
    assert said["better", "alike"] == "sooner, and alike in the end"
    assert said["better", "worse"] == "sooner, but worse in the end"
    assert said["worse", "not distinguishable"] == "later, and not distinguishable in the end"
    assert said["alike", "better"] == "better in the end only"
    for pair in (("alike", "not distinguishable"), ("not distinguishable", "alike")):
        assert said[pair] == "not distinguishable"
    assert on_both_axes("needs 2 seeds", "needs 2 seeds") == "needs 2 seeds"


def test_mean_until_the_same_number_of_trained_steps_by_hand(lite: Frames, runs: pd.DataFrame) -> None:
    own = runs[runs["teacher"].isin(["accel:budget=2000000", "random"]) & (runs["challenge"] == "original")]
    areas = trained_areas(trained_curves(lite), own, "accel:budget=2000000", STRATA).set_index("run_id")
    shares = trained_shares(lite)
    limit = min(2e6 * shares[run_id] / 100 for run_id in own.loc[own["teacher"] != "random", "run_id"])
    for run_id in own.loc[own["teacher"] == "random", "run_id"]:
        curve = lite.measured[lite.measured["run_id"] == run_id].sort_values("step")
        windows = lite.training[lite.training["run_id"] == run_id].sort_values("step")
        ends = np.cumsum(windows["episodes"] * windows["mean_length"].fillna(0))
        trained = np.interp(curve["step"], [0, *windows["step"]], [0, *ends])
        fine = np.linspace(0, limit, 200_001)
        expected = np.interp(fine, trained, curve["mastered_percent"]).mean()
        assert areas.loc[run_id, TRAINED] == pytest.approx(expected, abs=0.01)


def test_teachers_that_seldom_train_are_compared_per_trained_step(lite: Frames, runs: pd.DataFrame) -> None:
    """At equal steps ACCEL masters less than Random over training, at equal trained steps more."""
    found = {each.teacher: each for each in against_random(lite, runs)}
    partly = {name: each for name, each in found.items() if TRAINED in each.gaps}
    names = {name.partition(":")[0] for name in partly}
    assert names == {"accel", "robust_plr", "sfl", "traced"}
    accel = partly["accel:budget=2000000"]
    assert accel.verdict == "worse; per trained step better"
    assert accel.gaps[TRAINED].value == pytest.approx(4.6, abs=0.3)
    assert found["spgl:budget=2000000"].verdict == "sooner, and alike in the end"
    assert all(each.newcomer for each in partly.values())


def test_bodies_are_strata_of_one_challenge() -> None:
    """Two bodies with far means but little spread within decide what one sample does not."""
    levels = {"short_bipedal": 2.0, "spider": 16.0}
    rows = [
        cell(teacher, seed, base + gap + 0.2 * seed, embodiment=body, challenge="diverse_students")
        for teacher, gap in (("adr", 1.5), ("random", 0.0))
        for body, base in levels.items()
        for seed in range(5)
    ]
    test = pairwise(pool(*rows), "mastered_percent").iloc[0]
    assert test["difference"] == pytest.approx(1.5)
    assert test["p"] < 1e-4
    error = np.sqrt(4 * 0.1 / 5) / 2  # four samples of variance 0.1 and five runs, of weight a half
    assert test["t"] == pytest.approx(1.5 / error)
    margin = stats.t.ppf(0.975, 18) * np.sqrt(2 * 0.1 / 10)
    assert margin < test["detectable"] < 1.5 * margin


def test_levels_with_the_same_runs_are_one(lite: Frames) -> None:
    everything = runs_after(lite, training=False)
    levels = everything[everything["environment"] == "stump_tracks"]
    together = levels_together(levels, ["steps", "engine"])
    assert set(together["expert_knowledge"]) == {"none and low", "high"}
    assert len(together) == len(levels) - len(levels[levels["expert_knowledge"] == "low"])
