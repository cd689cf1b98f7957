"""Measures of whole runs, of their students and of their curricula."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_results import SMALL, SyntheticCampaign, mastering

from analysis.data.loading import load
from analysis.measures.curriculum_measures import coverage_and_entropy, curriculum_curves, curriculum_measures
from analysis.measures.run_measures import evaluations_at, measure_names, run_measures
from tma_ray.results import Table
from tma_ray.tasks import TaskSpace

CURVE = {0: mastering(0), 250: mastering(4), 500: mastering(10), 1000: mastering(8)}


def only(campaign: SyntheticCampaign, at: int | None = None) -> pd.Series:
    (row,) = run_measures(load(campaign.root), at).to_dict("records")
    return pd.Series(row)


def test_the_measures_of_a_learning_curve_by_hand(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, CURVE)
    row = only(campaign)
    assert (row["step"], row["mastered_percent"], row["evaluation_return"]) == (1000, 80, 240)
    # Trapezoids: 250 x 20 + 250 x 70 + 500 x 90, over 1000.
    assert row["mastered_area"] == pytest.approx(67.5)
    assert row["last_three"] == pytest.approx((40 + 100 + 80) / 3)
    assert (row["steps_to_50_percent"], row["steps_to_90_percent"]) == (250, 500)
    assert row["forgotten_percent"] == 20
    assert row["reason"] == ""


def test_measured_earlier_a_run_is_one_of_that_budget(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, CURVE)
    row = only(campaign, at=500)
    assert row[["steps", "step", "mastered_percent", "forgotten_percent"]].tolist() == [500, 500, 100, 0]
    assert row["mastered_area"] == pytest.approx((250 * 20 + 250 * 70) / 500)
    assert row["last_three"] == 70, "the untrained student is no result of training"
    assert only(campaign, at=100)["last_three"] == 0
    # Between evaluations the last one stands.
    row = only(campaign, at=400)
    assert (row["step"], row["mastered_percent"]) == (250, 40)
    assert row["mastered_area"] == pytest.approx((250 * 20 + 150 * 40) / 400)


def test_a_curve_without_its_ends_holds_the_values_it_has(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {200: mastering(2), 800: mastering(6)})
    assert only(campaign)["mastered_area"] == pytest.approx((200 * 20 + 600 * 40 + 200 * 60) / 1000)


def test_forgetting_counts_tasks_and_not_their_difference(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: [300, 300, 0, 0], 500: [0, 300, 0, 0], 1000: [0, 0, 300, 300]})
    row = only(campaign)
    assert (row["mastered_percent"], row["forgotten_percent"]) == (50, 50)


def test_who_masters_nothing_never_gets_there(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: mastering(0), 500: mastering(3), 1000: mastering(0)})
    row = only(campaign)
    assert row[["steps_to_50_percent", "steps_to_90_percent"]].isna().all()
    assert (row["mastered_percent"], row["forgotten_percent"], row["reason"]) == (0, 30, "")


def test_other_shares_have_columns_of_their_own(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: mastering(1), 500: mastering(3), 1000: mastering(4)})
    rows = run_measures(load(campaign.root), shares=(0.25, 0.75, 1.0))
    steps = {"steps_to_25_percent": 0, "steps_to_75_percent": 500, "steps_to_100_percent": 1000}
    assert rows.filter(like="steps_to_").iloc[0].to_dict() == steps


def test_why_a_run_has_no_measures(campaign: SyntheticCampaign) -> None:
    curve = {0: mastering(0), 500: mastering(5)}
    reasons = {
        campaign.plain_run("random", 0, curve | {1000: mastering(5)}): "",
        campaign.plain_run("random", 1, curve, "running"): "still running",
        campaign.plain_run("random", 2, curve, "failed"): "failed",
        campaign.run("random", 3, "waiting"): "waiting",
        campaign.plain_run("random", 4, {}): "not evaluated",
    }
    rows = run_measures(load(campaign.root)).set_index("run_id")
    assert rows["reason"].to_dict() == reasons
    without = rows[rows["reason"] != ""]
    assert without[measure_names()].isna().all(axis=None)
    assert rows.loc[rows["reason"] == "", "mastered_percent"].tolist() == [50]
    earlier = run_measures(load(campaign.root), at=500).set_index("run_id")["reason"]
    assert sorted(earlier) == ["", "", "failed", "not evaluated", "waiting"]
    assert set(run_measures(load(campaign.root), at=2000)["reason"]) >= {"ends before", "failed", "waiting"}


def test_a_root_without_runs_has_no_rows(campaign: SyntheticCampaign) -> None:
    frames = load(campaign.root)
    assert run_measures(frames).empty
    assert list(run_measures(frames).columns) == ["run_id", "steps", "step", *measure_names(), "reason"]
    assert evaluations_at(frames, [5]).empty


def test_runs_that_have_only_begun_are_no_error(campaign: SyntheticCampaign) -> None:
    for seed, status in enumerate(("running", "failed")):
        campaign.plain_run("random", seed, {}, status)
    campaign.run("random", 2, "waiting")
    assert run_measures(load(campaign.root))[measure_names()].isna().all(axis=None)
    assert evaluations_at(load(campaign.root), [0, 500]).empty


def test_the_training_return_is_the_mean_over_episodes(campaign: SyntheticCampaign) -> None:
    record = campaign.record("random", 0, "low", steps=1_500_000)
    campaign.cell(record, "low")
    windows = [(500_000, 10, -50.0), (1_000_000, 30, 70.0), (1_500_000, 40, 100.0)]
    rest = {"std_return": 0.0, "mean_length": 1.0, "success_share": 0.0}
    rows = [{"step": step, "episodes": n, "mean_return": mean} | rest for step, n, mean in windows]
    evaluated = {"step": 0, "test_set": "line", "task_index": 0, "task": [0.0], "length": 1}
    tables = {Table.TRAINING: rows, Table.EVALUATIONS: [evaluated | {"episodic_return": 1.0}]}
    campaign._write(record, "done", tables, 1_500_000)
    assert only(campaign)["training_return"] == pytest.approx((-500 + 2100 + 4000) / 80)
    assert only(campaign, at=1_200_000)["training_return"] == pytest.approx((-500 + 2100) / 40)


def test_without_windows_the_training_return_is_read_from_the_episodes(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, **SMALL | {"episode_steps": 700})
    run = campaign.run("random", 0)
    episodes = load(tmp_path).episode_returns([run])
    assert only(campaign)["training_return"] == pytest.approx(episodes["episodic_return"].mean())
    early = episodes[episodes["step"] <= 20_000]["episodic_return"].mean()
    assert only(campaign, at=20_000)["training_return"] == pytest.approx(early)


def test_evaluations_at_any_step_are_the_last_before_it(campaign: SyntheticCampaign) -> None:
    done = campaign.plain_run("random", 0, {0: mastering(0), 500: mastering(5), 1000: mastering(7)})
    running = campaign.plain_run("random", 1, {0: mastering(1), 500: mastering(2)}, "running")
    campaign.plain_run("random", 2, {0: mastering(9), 500: mastering(9)}, "failed")
    short = campaign.plain_run("random", 3, {0: mastering(3), 400: mastering(4)}, steps=400)
    frames = load(campaign.root)
    rows = evaluations_at(frames, [250, 500, 750, 1000]).set_index(["step", "run_id"])
    expected = {(250, done): 0, (250, running): 10, (250, short): 30, (500, done): 50, (500, running): 20}
    assert rows["mastered_percent"].to_dict() == expected | {(750, done): 50, (1000, done): 70}
    assert rows.loc[(750, done), "evaluated_at"] == 500


SQUARE = TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6)})


def tasks(*rows: tuple[float, ...]) -> np.ndarray:
    return np.array(rows, dtype=np.float32)


ENTROPY = -(0.75 * math.log(0.75) + 0.25 * math.log(0.25)) / math.log(4)


@pytest.mark.parametrize(
    ("rows", "bins", "expected"),
    [
        # Two bins a side: three tasks in one cell and one in the opposite one.
        ([(0, 0), (1, 1), (1.4, 2.9), (3, 6)], 2, (0.5, ENTROPY)),
        ([(h, s) for h in 0.15 + 0.3 * np.arange(10) for s in 0.3 + 0.6 * np.arange(10)], 10, (1, 1)),
        ([(1, 1), (1, 1)], 10, (0.01, 0)),
        ([(3, 6), (9, 9), (-1, -1), (0, 0)], 2, (0.5, 0.5)),  # what lies outside counts at the edge
    ],
)
def test_cells_by_hand(rows: list[tuple[float, float]], bins: int, expected: tuple[float, float]) -> None:
    assert coverage_and_entropy(tasks(*rows), SQUARE, bins) == pytest.approx(expected)


def test_dimensions_without_width_do_not_count() -> None:
    wide = TaskSpace.from_bounds({"height": (0, 3), "width": (2, 2), "spacing": (0, 6)})
    two = tasks((0, 0), (1, 5), (2, 3))
    three = tasks(*[(h, 2, s) for h, s in two])
    assert coverage_and_entropy(three, wide) == coverage_and_entropy(two, SQUARE)


def test_many_dimensions_are_measured_one_by_one() -> None:
    space = TaskSpace.from_bounds(dict.fromkeys("abcd", (0, 1)))
    # Two bins: three dimensions where half of the tasks lie in each, one where all lie in one.
    found = coverage_and_entropy(tasks((0, 0, 0, 0), (1, 1, 1, 0)), space, bins=2)
    assert found == pytest.approx(((1 + 1 + 1 + 0.5) / 4, 3 / 4))


def test_without_tasks_or_a_choice_there_is_nothing_to_measure() -> None:
    point = TaskSpace.from_bounds({"height": (1, 1)})
    assert all(map(math.isnan, coverage_and_entropy(tasks((1.0,)), point)))
    assert all(map(math.isnan, coverage_and_entropy(np.empty((0, 2), np.float32), SQUARE)))


def test_a_grid_of_one_cell_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1 bins: expected .* at least 2"):
        coverage_and_entropy(tasks((1, 1)), SQUARE, bins=1)


@given(st.lists(st.tuples(st.floats(0, 3), st.floats(0, 6)), min_size=1, max_size=40), st.integers(2, 12))
def test_both_lie_between_0_and_1(points: list[tuple[float, float]], bins: int) -> None:
    coverage, entropy = coverage_and_entropy(tasks(*points), SQUARE, bins)
    assert 0 < coverage <= 1
    assert -1e-12 <= entropy <= 1 + 1e-12
    assert round(coverage * bins**2) <= len(points)


def test_random_covers_more_than_a_guided_teacher(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, **SMALL)
    runs = [campaign.run("alp_gmm", 0), campaign.run("random", 0)]
    frames = load(tmp_path)
    whole = curriculum_measures(frames, runs).set_index("run_id")
    assert list(whole.index) == runs
    for name in ("coverage", "entropy"):
        assert whole.loc[runs[1], name] > whole.loc[runs[0], name]
    curves = curriculum_curves(frames, runs)
    assert set(curves["tasks"]) == {40}
    assert curves.groupby("run_id")["tasks"].sum().to_dict() == whole["tasks"].to_dict()
    last = curves["step"].max()
    early = curriculum_measures(frames, runs, at=last - 1).set_index("run_id")
    assert (whole["tasks"] - early["tasks"] == 40).all()


def test_runs_without_probes_or_a_task_space_have_no_measures(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, **SMALL)
    runs = [
        campaign.plain_run("random", 0, {0: [1.0]}),
        campaign.run("random", 1, spec=json.dumps({})),
        campaign.run("random", 2, "waiting"),
    ]
    measured = curriculum_measures(load(tmp_path), runs)
    assert measured[["coverage", "entropy"]].isna().all(axis=None)
    assert list(measured["tasks"] > 0) == [False, True, False]
    assert curriculum_measures(load(tmp_path), []).empty
