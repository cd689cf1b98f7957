import itertools
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic_results import SMALL, SyntheticCampaign

from analysis.comparisons.comparison import Measurements
from analysis.data.frames import with_plain_texts
from analysis.data.loading import load
from analysis.data.reference import NO_BASELINE
from analysis.measures import evaluations
from tma_ray.cli import main


def finals_by_run(campaign: SyntheticCampaign):
    return evaluations.final_evaluations(load(campaign.root)).set_index("run_id")


def test_finished_runs_are_read_at_their_end_strictly_over_the_threshold(campaign: SyntheticCampaign) -> None:
    returns = [230.0, 230.0001, 300, -100]
    run = campaign.plain_run("random", 0, {0: [300] * 4, 500: [300] * 4, 1000: returns})
    finals = finals_by_run(campaign).loc[run]
    assert (finals["step"], finals["mastered_percent"]) == (1000, 50)
    assert finals["evaluation_return"] == pytest.approx(np.mean(returns))
    assert not finals["provisional"]


def test_running_runs_wait_for_finished_ones(campaign: SyntheticCampaign) -> None:
    done = campaign.plain_run("random", 0, {0: [0], 1000: [300]})
    campaign.plain_run("random", 1, {0: [0], 500: [300]}, status="running")
    assert list(finals_by_run(campaign).index) == [done]


def test_a_group_under_way_is_read_where_all_its_runs_have_been(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: [0], 250: [300], 500: [0], 750: [0]}, status="running")
    campaign.plain_run("random", 1, {0: [0], 250: [0]}, status="running")
    campaign.plain_run("random", 2, {0: [0]}, status="failed")
    finals = finals_by_run(campaign)
    assert list(finals["step"]) == [250, 250]
    assert list(finals["mastered_percent"]) == [100, 0]
    assert finals["provisional"].all()


def test_failed_runs_count_nowhere_but_in_the_counts(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: [0], 1000: [300]})
    failed = campaign.plain_run("random", 1, {0: [0], 1000: [0]}, status="failed")
    measured = Measurements(load(campaign.root))
    for table in (measured.finals, measured.evaluations):
        assert failed not in set(table["run_id"])
    row = measured.summary.iloc[0]
    assert (row["seeds"], row["n"], row["done"], row["failed"]) == (2, 1, 1, 1)


def test_the_ceiling_is_of_tasks_that_any_run_ever_masters(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: [0, 0, 0, 0], 500: [300, 300, 0, 0], 1000: [300, 0, 0, 0]})
    campaign.plain_run("adr", 0, {0: [0, 0, 0, 0], 1000: [300, 0, float("nan"), 300]})
    (row,) = evaluations.ceilings(load(campaign.root)).to_dict("records")
    numbers = {"tasks": 4, "ever": 3, "last": 2, "best_percent": 50.0}
    assert row == {"environment": "stump_tracks", "test_set": row["test_set"]} | numbers
    assert evaluations.ceilings(load(SyntheticCampaign(campaign.root / "empty").root)).empty


def test_curves_are_means_with_standard_errors_over_runs(campaign: SyntheticCampaign) -> None:
    for seed, last in enumerate([[300, 0], [300, 300], [0, 0]]):
        campaign.plain_run("random", seed, {0: [0, 0], 1000: last})
    curves = evaluations.evaluation_curves(load(campaign.root))
    table = evaluations.aggregate(curves, "mastered_percent").set_index("step")
    assert list(table["n"]) == [3, 3]
    assert table.loc[1000, "mean"] == 50
    assert table.loc[1000, "std"] == pytest.approx(50)
    assert table.loc[1000, "standard_error"] == pytest.approx(50 / np.sqrt(3))


def test_shares_of_seeds_that_master_each_task(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {0: [300, 300, 300], 1000: [300, 0, 300]})
    campaign.plain_run("random", 1, {0: [300, 300, 300], 1000: [0, 0, 300]})
    frames = load(campaign.root)
    shares = evaluations.mastered_tasks(frames, evaluations.final_evaluations(frames))
    assert list(shares["share"]) == [0.5, 0.0, 1.0]
    assert list(shares["n"]) == [2, 2, 2]


def test_every_teacher_is_tested_against_random_once(campaign: SyntheticCampaign) -> None:
    campaign.seeds("random", [1, 2, 1, 2], 4)
    campaign.seeds("alp_gmm", [3, 4, 4, 3], 4)
    campaign.seeds("spdl", [0, 0, 1, 0], 4)
    measured = Measurements(load(campaign.root))
    tests = measured.tests[measured.tests["measure"] == "mastered_percent"].set_index("teacher")
    assert list(tests.index) == ["alp_gmm", "spdl"]
    assert tests.loc["alp_gmm", "difference"] == pytest.approx(50)
    # Both samples have variance 625 / 3 over 4 seeds: t = 50 / sqrt(2 * 625 / 3 / 4/ 1.0), in percent.
    assert tests.loc["alp_gmm", "t"] == pytest.approx(50 / np.sqrt(2 * (625 / 3) / 4))
    assert tests.loc["alp_gmm", "degrees_of_freedom"] == pytest.approx(6)
    assert (tests["holm"] >= tests["p"]).all()


def test_random_of_another_level_serves_where_there_is_no_other(campaign: SyntheticCampaign) -> None:
    campaign.seeds("random", [1, 2, 2], 4, level="none")
    campaign.seeds("adr", [2, 3, 3], 4, level="high")
    test = Measurements(load(campaign.root)).tests.iloc[0]
    assert (test["teacher"], test["expert_knowledge"], test["reason"]) == ("adr", "high", "")
    assert test["difference"] == pytest.approx(25)


def test_unfinished_teachers_are_set_beside_random_at_the_same_step(campaign: SyntheticCampaign) -> None:
    for seed in range(2):
        campaign.plain_run("random", seed, {0: [0, 0], 500: [300, 0], 1000: [300, 300]})
        campaign.plain_run("adr", seed, {0: [0, 0], 500: [300, 300]}, status="running")
    test = Measurements(load(campaign.root)).tests.iloc[0]
    assert (test["reason"], test["step"], test["difference"]) == ("still running", 500, 25)
    assert np.isnan(test["p"])


def test_other_budgets_are_not_compared(campaign: SyntheticCampaign) -> None:
    for seed in range(2):
        campaign.plain_run("random", seed, {1000: [300 * seed]})
        campaign.plain_run("adr", seed, {2000: [300 * seed]}, steps=2000)
    frames = load(campaign.root)
    assert Measurements(frames).tests.iloc[0]["reason"] == NO_BASELINE
    assert any("stand apart: 1,000 steps" in warning for warning in frames.warnings)


def test_cells_that_share_runs_are_averaged_each_and_counted_once(campaign: SyntheticCampaign) -> None:
    campaign.seeds("random", [1, 2], level="none")
    for name, levels in (("first_look", ("low", "high")), ("the_same_again", ("none",))):
        campaign.campaign = name
        for seed, level in itertools.product(range(2), levels):
            campaign.cell(campaign.record("random", seed, "none"), level)
    summary = evaluations.summarise(frames := load(campaign.root), evaluations.final_evaluations(frames))
    assert list(summary["expert_knowledge"]) == ["high", "low", "none"]
    assert list(summary["n"]) == list(summary["done"]) == [2, 2, 2]
    curves = evaluations.aggregate(evaluations.evaluation_curves(frames), "mastered_percent")
    assert set(curves["n"]) == {2}


def test_training_returns_of_a_short_run_are_means_of_its_latest_episodes(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, **SMALL | {"episode_steps": 700})
    run, half = campaign.run("random", 0), campaign.run("random", 1, "running", 0.5)
    frames = load(tmp_path)
    episodes = frames.episode_returns([run])
    returns, steps, end = episodes["episodic_return"], episodes["step"], episodes["step"].max()
    curves = evaluations.training_curves(frames).set_index(["run_id", "step"])["training_return"]
    curve = curves[run]
    assert list(curve.index) == list(range(1_000, 40_001, 1_000))
    assert curve[1_000] == pytest.approx(returns[0])
    assert curve[30_000] == pytest.approx(returns[steps <= 30_000][-20:].mean())
    quarters = evaluations.training_quarters(frames).iloc[0]
    assert quarters["first_quarter"] == pytest.approx(returns[steps <= end / 4].mean())
    assert quarters["last_quarter"] == pytest.approx(returns[steps > end * 3 / 4].mean())
    assert curves[half].index.max() == 19_000  # the last episode ended at 19,600


def test_training_returns_of_a_long_run_come_from_its_windows(tmp_path: Path) -> None:
    sizes = {"steps": 5_000_000, "evaluation_every": 5_000_000, "episode_steps": 50_000, "grid": 3}
    campaign = SyntheticCampaign(tmp_path, **sizes)
    run = campaign.run("random", 0)
    frames = load(tmp_path)
    curve = evaluations.training_curves(frames)
    assert list(curve["step"]) == list(range(500_000, 5_000_001, 500_000))
    windows = frames.training[frames.training["run_id"] == run]["mean_return"]
    np.testing.assert_array_equal(curve["training_return"], windows)


def test_runs_outside_campaigns_are_read_too(campaign: SyntheticCampaign) -> None:
    record = campaign.record("random", 0, "low", spec=json.dumps({}))
    campaign.committer.start(record)
    cells = load(campaign.root).cells
    assert list(cells["experiment"]) == ["single runs"]
    assert list(cells["status"]) == ["running"]


def test_each_run_is_judged_by_its_own_threshold(campaign: SyntheticCampaign) -> None:
    own = {"environment": "pendulum", "spec": json.dumps({"mastery_threshold": -50.0}), "run_id": "own"}
    runs = [campaign.plain_run("random", 0, {1000: [-60, -40, 231]}, **each) for each in ({}, own)]
    finals = finals_by_run(campaign)
    assert list(finals.loc[runs, "mastered_percent"].round()) == [33, 67]
    frames = load(campaign.root)
    shares = evaluations.mastered_tasks(frames, evaluations.final_evaluations(frames))
    assert shares.loc[shares["environment"] == "pendulum", "share"].tolist() == [0, 1, 1]
    assert not frames.warnings


def test_mixed_thresholds_and_versions_of_a_plugin_are_warned_of(campaign: SyntheticCampaign) -> None:
    for seed, (threshold, digest) in enumerate([(1.0, "old"), (2.0, "new")]):
        plugins = {"teacher": {"module": "mine", "digest": digest}}
        spec = json.dumps({"teacher": "mine", "mastery_threshold": threshold, "plugins": plugins})
        campaign.plain_run("mine", seed, {1000: [3]}, spec=spec)
    warnings = " ".join(load(campaign.root).warnings)
    assert "stand apart: mastered over 1" in warnings
    assert "1 run of teacher 'mine' stand apart as 'mine:source=new'" in warnings


TEXTS = ["alp_gmm", None, "random"]


@pytest.mark.parametrize("dtype", ["object", "string", "category", pd.StringDtype("pyarrow")], ids=str)
def test_texts_and_categories_become_objects(dtype: object) -> None:
    frame = pd.DataFrame({"teacher": pd.Series(TEXTS, dtype=dtype), "seed": [0, 1, 2]})
    plain = with_plain_texts(frame)
    assert (plain["teacher"].dtype, plain["seed"].dtype) == (object, frame["seed"].dtype)
    assert plain["teacher"].dropna().tolist() == ["alp_gmm", "random"]


@pytest.mark.filterwarnings("ignore:The 'future.infer_string' option is deprecated")
@pytest.mark.parametrize("inferred", [True, False])
def test_results_are_read_with_and_without_inferred_texts(tmp_path, capsys, inferred):
    """Without them, pandas 3 reads texts as pandas 2 does."""
    campaign = SyntheticCampaign(tmp_path, **SMALL)
    for teacher in ("random", "alp_gmm"):
        for seed in range(3):
            campaign.run(teacher, seed)
    with pd.option_context("future.infer_string", inferred):
        frames = load(tmp_path)
        assert sorted(frames.cells["teacher"]) == 3 * ["alp_gmm"] + 3 * ["random"]
        assert frames.cells["teacher"].dtype == object
        assert main(["ranking", str(tmp_path)]) == 0
    assert "alp_gmm" in capsys.readouterr().out.lower().replace("-", "_")
