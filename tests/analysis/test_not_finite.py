"""Returns that are NaN or infinite: excluded and counted in every view, and never taken for zero."""

import math
from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign
from views import printed

from analysis.claims.sources import RootSource
from analysis.commands.claims import show_claims
from analysis.commands.paper import write_figures, write_tables
from analysis.commands.rankings import show_ranking
from analysis.comparisons.comparison import Measurements
from analysis.comparisons.pairwise import pairwise
from analysis.data.loading import load
from analysis.measures.evaluations import evaluation_curves, mastered_tasks
from analysis.measures.pooling import pooled, runs_after
from analysis.measures.run_measures import NOT_FINITE, run_measures
from analysis.pages.report import write_report
from tma_ray.benchmark.claims import Reading
from tma_ray.tasks import KnowledgeLevel

GOOD, STEPS = [300.0, 300.0, 0.0, 0.0], 1000
SENTENCE = "2 returns of 2 evaluations are NaN or infinite; these evaluations are excluded (2 runs: "


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seeds of two teachers that master half of the tasks; one return of two runs is no number."""
    root = tmp_path_factory.mktemp("root")
    campaign = SyntheticCampaign(root, steps=STEPS)
    for teacher in ("random", "riac"):
        for seed in range(4):
            end = [*GOOD]
            if teacher == "riac" and seed < 2:
                end[seed] = (math.nan, math.inf)[seed]
            campaign.plain_run(teacher, seed, {500: GOOD, STEPS: end}, level="none")
    return root


def test_an_evaluation_with_such_a_return_has_no_measures(root: Path) -> None:
    frames = load(root)
    runs = run_measures(frames).set_index("run_id")
    broken = runs[runs["reason"] == NOT_FINITE]
    assert len(broken) == 2
    assert broken.drop(columns=["steps", "step", "reason"]).isna().all(axis=None)
    assert (runs.drop(broken.index)["mastered_percent"] == 50).all()
    assert len(evaluation_curves(frames)) == 14
    (warning,) = frames.warnings
    assert warning.startswith(SENTENCE)


def test_a_return_that_is_missing_earlier_leaves_the_end_as_it_is(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, steps=STEPS)
    run = campaign.plain_run("riac", 0, {250: GOOD, 500: [math.inf, 300.0, 300.0, 300.0], STEPS: GOOD})
    row = run_measures(load(tmp_path)).set_index("run_id").loc[run]
    assert (row["mastered_percent"], row["mastered_area"], row["forgotten_percent"]) == (50, 50, 0)


def test_means_and_numbers_are_of_the_same_runs(root: Path) -> None:
    frames = load(root)
    row = pooled(runs_after(frames)).set_index("teacher").loc["riac"]
    assert (row["runs"], row["n"], row["mastered_percent_mean"]) == (4, 2, 50)
    assert row["missing"] == f"not counted: 2 {NOT_FINITE}"
    test = pairwise(runs_after(frames), "mastered_percent", "random").iloc[0]
    assert (test["n"], test["reference_n"], test["difference"], test["uncounted"]) == (2, 4, 0, 2)
    measured = Measurements(frames)
    group = measured.summary.set_index("teacher").loc["riac"]
    assert (group["seeds"], group["n"], group["mastered_percent_mean"]) == (4, 2, 50)
    assert group["evaluation_return_mean"] == 150
    shares = mastered_tasks(frames, measured.finals).set_index(["teacher", "task_index"])
    assert shares.loc["riac", "n"].tolist() == [2, 2, 2, 2]
    assert shares.loc["riac", "share"].tolist() == [1, 1, 0, 0]


def test_claims_count_the_same_runs(root: Path) -> None:
    source = RootSource(load(root))
    assert source.sample(Reading("riac", "original", KnowledgeLevel.NONE)) is None, "the pool is not complete"
    sample = source.sample(Reading("random", "original", KnowledgeLevel.NONE))
    assert sample is not None
    assert sample.description.n == 4


@pytest.mark.slow
def test_every_view_says_how_many(root: Path, tmp_path: Path) -> None:
    for show in (show_ranking, show_claims):
        assert printed(show, root, width=300).count(SENTENCE) == 1
    page = write_report(root, tmp_path).read_text()
    assert "2 of 4" in page
    assert SENTENCE in page
    assert any(SENTENCE in each for each in write_tables(root).warnings)
    assert any(SENTENCE in each for each in write_figures(root, tmp_path / "figures", only="bars").warnings)
