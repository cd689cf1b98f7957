import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic_pools import PARKOUR_POOL, cell, parkour, pool
from synthetic_results import SyntheticCampaign

from analysis.data.columns import POOLED
from analysis.data.loading import load
from analysis.measures.pooling import pool_runs, pooled, reuse_random
from analysis.measures.run_measures import evaluations_at, run_measures

THREE_BODIES = {"classic_bipedal": [30, 50], "fish": [0, 60], "climbing_chimpanzee": [0, 1]}


def only(runs: pd.DataFrame, **options: object) -> pd.Series:
    (row,) = pooled(runs, **options).to_dict("records")
    return pd.Series(row)


def diverse(*parts: tuple[str, str], seeds: int = 2, teacher: str = "random") -> list[dict[str, object]]:
    return [
        cell(teacher, seed, seed, challenge="diverse_students", embodiment=body, student=student)
        for body, student in parts
        for seed in range(seeds)
    ]


DIVERSE = [(body, student) for body in ("short_bipedal", "spider") for student in ("sac", "ppo")]


def test_parkour_pools_its_three_bodies_over_experiments_and_test_sets() -> None:
    runs = pool(*parkour("random", THREE_BODIES))
    row = only(runs)
    values = [30, 50, 0, 60, 0, 1]
    assert (row["n"], row["runs"], row["missing"], row["pool"]) == (6, 6, "", PARKOUR_POOL)
    assert row["mastered_percent_mean"] == pytest.approx(np.mean(values))
    assert row["mastered_percent_std"] == pytest.approx(np.std(values, ddof=1))
    assert row["test_sets"] == "parkour_climbing + parkour_swimming + parkour_walking"
    table = pooled(runs, by=["embodiment"]).set_index("embodiment")
    means = {"classic_bipedal": 40, "climbing_chimpanzee": 0.5, "fish": 30}
    assert table["mastered_percent_mean"].to_dict() == means
    assert set(table["missing"]) == {""}


def test_diverse_students_pool_two_bodies_by_two_students() -> None:
    row = only(pool(*diverse(*DIVERSE)))
    assert (row["n"], row["missing"]) == (8, "")
    per_student = pooled(pool(*diverse(*DIVERSE)), by=["student"])
    assert list(per_student["n"]) == [4, 4]
    assert set(per_student["missing"]) == {""}


TWO_BODIES = {"classic_bipedal": [1, 2], "climbing_chimpanzee": [3, 4]}

UNFINISHED = [
    cell("random", seed, math.nan, status=status)
    for seed, status in enumerate(("running", "failed", "waiting", "waiting"), start=2)
]

ONE, OTHER = cell("random", 0, 10), cell("random", 1, 20)


@pytest.mark.parametrize(
    ("cells", "runs", "n", "missing"),
    [
        (parkour("random", TWO_BODIES), 4, 4, "no results of fish/sac"),
        (diverse(*DIVERSE[:3]), 6, 6, "no results of spider/ppo"),
        (
            parkour("random", THREE_BODIES | {"fish": [1, 2, 3]}), 7, 7,
            "unequal numbers of seeds: classic_bipedal/sac 2, climbing_chimpanzee/sac 2, fish/sac 3",
        ),
        ([ONE, OTHER, *UNFINISHED], 6, 2, "not counted: 1 running, 1 failed, 2 waiting"),
        (UNFINISHED[2:], 2, 0, "not counted: 2 waiting; no results of classic_bipedal/sac"),
        (
            [ONE, cell("random", 0, 2, settings="three layers", run_id="another")], 2, 2,
            "different settings: classic_bipedal/sac; seeds counted more than once: classic_bipedal/sac",
        ),
        ([ONE, OTHER | {"step": 900.0}], 2, 2, "evaluated at different steps: 900, 1,000"),
        ([ONE, ONE | {"experiment": "again", "campaign": "second"}], 1, 1, ""),
    ],
)  # fmt: skip
def test_what_a_pool_lacks_is_named(cells: Iterable[dict[str, Any]], runs: int, n: int, missing: str) -> None:
    row = only(pool(*cells))
    assert (row["runs"], row["n"], row["missing"]) == (runs, n, missing)
    assert math.isnan(row["mastered_percent_mean"]) == (n == 0)


def test_a_body_with_under_half_of_the_teachers_is_a_pool_of_its_own() -> None:
    two = {body: values for body, values in THREE_BODIES.items() if body != "climbing_chimpanzee"}
    few = [row for name in ("random", "adr") for row in parkour(name, THREE_BODIES)]
    for others, pools in ((2, 1), (3, 2)):
        cells = [*few, *(row for name in ("alp_gmm", "riac", "spdl")[:others] for row in parkour(name, two))]
        table = pooled(pool(*cells))
        assert table["pool"].nunique() == pools
        complete = set(table["teacher"][table["missing"] == ""])
        assert len(complete) == (2 if pools == 1 else 2 + others)
    climbing = table[table["pool"] == "climbing_chimpanzee/sac"]
    assert (set(climbing["teacher"]), set(climbing["n"])) == ({"random", "adr"}, {2})
    assert set(climbing["variant"]) == {"climbing_chimpanzee"}
    assert set(table["variant"]) - set(climbing["variant"]) == {"classic_bipedal, fish"}


def test_teachers_on_one_body_alone_and_newcomers_split_no_pool() -> None:
    whole = [row for name in ("random", "adr") for row in parkour(name, THREE_BODIES)]
    others = ("alp_gmm", "riac", "spdl", "sfl")
    fish = [row for name in others for row in parkour(name, {"fish": [5, 6]})]
    assert set(pool(*whole, *fish)["pool"]) == {PARKOUR_POOL}
    two = {body: THREE_BODIES[body] for body in ("classic_bipedal", "fish")}
    more = [row for name in others for row in parkour(name, two)]
    assert len(set(pool(*whole, *more)["pool"])) == 2
    newcomers = [row | {"core": False} for row in more]
    assert set(pool(*(row | {"core": True} for row in whole), *newcomers)["pool"]) == {PARKOUR_POOL}


def test_what_a_body_of_a_pool_lacks_is_named_there_alone() -> None:
    per_body = pooled(pool(*diverse(*DIVERSE[:3])), by=["embodiment"]).set_index("embodiment")
    assert per_body["missing"].to_dict() == {"short_bipedal": "", "spider": "no results of spider/ppo"}


@pytest.mark.parametrize(
    ("column", "other"),
    [
        ("steps", 2000.0),
        ("physics_version", 2.0),
        ("mastery_threshold", 100.0),
        ("test_set", "mine"),
        ("expert_knowledge", "high"),
        ("challenge", "mostly_trivial"),
    ],
)
def test_what_must_not_be_pooled_is_not(column: str, other: object) -> None:
    same, different = cell("random", 0, 10), cell("random", 1, 20, **{column: other}, run_id="other")
    table = pooled(pool(same, different))
    assert sorted(table["mastered_percent_mean"]) == [10, 20]


def test_a_body_tested_on_several_shipped_sets_is_not_pooled() -> None:
    wrong = parkour("random", {"fish": [9]}, test_set="parkour_walking", run_id="wrong")
    table = pooled(pool(*parkour("random", THREE_BODIES), *wrong))
    assert list(table["n"].sort_values()) == [1, 2, 4]
    assert "no results of fish/sac" in set(table["missing"])


def test_other_bodies_and_students_stand_alone() -> None:
    runs = pool(cell("random", 0, 10), cell("random", 0, 30, embodiment="spider"))
    table = pooled(runs).set_index("pool")
    assert table["mastered_percent_mean"].to_dict() == {"classic_bipedal/sac": 10, "spider/sac": 30}
    assert set(table["missing"]) == {""}
    path = "bodies + more/mine.json"
    assert only(pool(cell("random", 0, 1, embodiment=path)))["missing"] == ""


def test_waiting_runs_belong_where_the_others_are() -> None:
    started = list(parkour("random", {"classic_bipedal": [1, 2]}))
    waiting = list(parkour("adr", {"fish": [math.nan]}, status="waiting"))
    table = pooled(pool(*started, *waiting)).set_index("teacher")
    assert table.loc["adr", "test_sets"] == table.loc["random", "test_sets"]
    assert table.loc["adr", "steps"] == 1000


def test_random_is_lent_to_levels_at_which_it_was_not_run() -> None:
    own = {("none", "random"): 1, ("low", "random"): 2, ("high", "adr"): 3, ("low", "adr"): 3}
    runs = pool(*(cell(name, 0, value, expert_knowledge=level) for (level, name), value in own.items()))
    lent = pooled(reuse_random(runs)).set_index(["expert_knowledge", "teacher"])["mastered_percent_mean"]
    assert lent.to_dict() == own | {("high", "random"): 1}


def test_without_random_nothing_is_lent() -> None:
    runs = pool(cell("adr", 0, 3), cell("adr", 0, 3, expert_knowledge="high"))
    pd.testing.assert_frame_equal(reuse_random(runs), runs)


def test_several_measures_are_described_each_over_its_values() -> None:
    runs = pool(cell("random", 0, 0), cell("random", 1, 10), cell("random", 2, 20))
    runs["steps_to_50_percent"] = [math.nan, 500.0, 700.0]
    row = only(runs, measures=["mastered_percent", "steps_to_50_percent"])
    assert (row["n"], row["mastered_percent_n"], row["steps_to_50_percent_n"]) == (3, 3, 2)
    assert (row["mastered_percent_mean"], row["steps_to_50_percent_mean"]) == (10, 600)


def test_from_a_root_to_results_and_learning_curves(campaign: SyntheticCampaign) -> None:
    for seed, last in enumerate([[300, 0], [300, 300]]):
        campaign.plain_run("random", seed, {0: [0, 0], 500: [300, 0], 1000: last})
    campaign.plain_run("random", 2, {0: [0, 0], 500: [0, 0]}, "running")
    campaign.run("random", 3, "waiting")
    frames = load(campaign.root)
    row = only(pool_runs(frames.cells, run_measures(frames)))
    assert (row["n"], row["mastered_percent_mean"], row["steps"]) == (2, 75, 1000)
    assert row["missing"] == "not counted: 1 running, 1 waiting"
    curves = pooled(pool_runs(frames.cells, evaluations_at(frames, [500, 1000])), by=["step"])
    curves = curves.set_index("step")
    assert curves["n"].to_dict() == {500: 3, 1000: 2}
    assert curves.loc[500, "mastered_percent_mean"] == pytest.approx(100 / 3)
    missing = {500: "not counted: 1 waiting", 1000: "not counted: 1 running, 1 waiting"}
    assert curves["missing"].to_dict() == missing
    early = only(pool_runs(frames.cells, run_measures(frames, at=500)))
    assert (early["n"], early["mastered_percent_mean"]) == (3, pytest.approx(100 / 3))


def test_an_empty_root_has_empty_tables(campaign: SyntheticCampaign) -> None:
    frames = load(campaign.root)
    runs = pool_runs(frames.cells, run_measures(frames))
    assert list(runs.columns[: len(POOLED)]) == POOLED
    assert pooled(runs).empty
    assert pooled(reuse_random(runs), by=["embodiment"]).empty
    assert pool_runs(frames.cells, evaluations_at(frames, [100])).empty
