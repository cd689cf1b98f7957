"""What reports have on request: videos of policies, and everything for LaTeX."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign

from analysis import load
from analysis.commands.paper import write_latex
from analysis.comparisons.comparison import Measurements
from analysis.pages.report import Video, wanted_videos, write_report
from analysis.pages.sections import distinct


@pytest.fixture
def root(campaign: SyntheticCampaign) -> Path:
    """Task 1 tells the runs apart; seed 2 of ADR is the best, seed 0 the worst."""
    campaign.plain_run("random", 0, {1000: [300.0, -100.0, 10.0]})
    for seed, value in enumerate((0.0, 240.0, 300.0)):
        campaign.plain_run("adr", seed, {1000: [300.0 - seed, value, 10.0]})
    return campaign.root


def test_the_best_and_the_worst_seed_play_the_task_that_tells_runs_apart(root: Path) -> None:
    wanted = list(wanted_videos(Measurements(load(root))))
    assert [(each.teacher, each.seed, each.rank) for each in wanted] == [
        ("random", 0, "only"),
        ("adr", 2, "best"),
        ("adr", 0, "worst"),
    ]
    assert {(each.test_set, each.task_index, each.task) for each in wanted} == {("line", 1, "1")}


@pytest.mark.parametrize(("ending", "element"), [("mp4", "<video"), ("gif", "<img")])
@pytest.mark.slow
def test_videos_are_embedded_with_outcomes(root: Path, tmp_path: Path, ending: str, element: str) -> None:
    file = tmp_path / f"one.{ending}"
    file.write_bytes(b"moving")
    assert "Policies at work" not in write_report(root).read_text()
    videos = [Video(each, file, 123.4) for each in wanted_videos(Measurements(load(root)))]
    text = re.sub(r"\s+", " ", write_report(root, videos=videos).read_text())
    assert text.count("base64,bW92aW5n") == 3
    assert f"{element} " in text
    assert "ADR, seed 2 (its best seed by mastered tasks), on test task 1 (1): return 123.4" in text


@pytest.mark.slow
def test_latex_shows_every_table_and_figure_it_wrote(root: Path, tmp_path: Path) -> None:
    (document,) = write_latex(root, tmp_path / "latex").files
    text = document.read_text()
    inputs = re.findall(r"\\input\{(.+?)\}", text)
    pictures = re.findall(r"\\includegraphics\[.*?\]\{\{(.+?)\}\.pdf\}", text)
    assert {(document.parent / name) for name in inputs} == set((document.parent / "tables").glob("*.tex"))
    assert {f"{document.parent / name}.pdf" for name in pictures} == {
        str(path) for path in (document.parent / "figures").glob("*.pdf")
    }
    assert inputs
    assert pictures


def test_rows_of_an_overview_leave_out_what_all_share() -> None:
    titles = ["Stump Tracks, original, PPO", "Stump Tracks, mostly trivial, PPO"]
    assert distinct(titles) == ["original", "mostly trivial"]
    assert distinct(["same, parts", "same, parts"]) == ["same, parts", "same, parts"]


def test_titles_name_the_place_once_and_experiments_where_titles_would_be_equal(tmp_path: Path) -> None:
    for experiment, environment in {"plain": "parkour", "swinging": "parkour:swinging_creepers=true"}.items():
        walker = {"environment": environment, "test_set": "parkour_walking"}
        SyntheticCampaign(tmp_path, steps=1000, experiment=experiment).seeds("riac", (1, 2), **walker)
    for experiment in ("original", "again"):
        campaign = SyntheticCampaign(tmp_path, steps=1000, experiment=experiment)
        campaign.seeds("riac", (1, 2), challenge="original")
    known = "Stump Tracks, original task space, classic bipedal, SAC, expert knowledge low"
    assert sorted(comparison.title for comparison in Measurements(load(tmp_path)).comparisons) == [
        "Parkour (swinging_creepers=true), classic bipedal, SAC, expert knowledge low",
        "Parkour, classic bipedal, SAC, expert knowledge low",
        f"again, {known}",
        f"original, {known}",
    ]
