"""Who masters most on each challenge, and what may be said of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis.commands.rankings import show_ranking
from analysis.comparisons.boards import headlines, overall
from analysis.comparisons.sentences import ranked, ranking, ranking_sentences
from analysis.data.frames import load
from analysis.measures.pooling import runs_after


def write(root: Path, teacher: str, mastered: list[int], challenge: str, level: str = "none") -> None:
    """Write finished runs that master so many of ten test tasks in the end, and none at half time."""
    campaign = SyntheticCampaign(root, experiment=challenge)
    for seed, count in enumerate(mastered):
        end = [300.0] * count + [0.0] * (10 - count)
        returns = {campaign.steps // 2: [0.0] * 10, campaign.steps: end}
        campaign.plain_run(teacher, seed, returns, level=level, challenge=challenge)


def shown(root: Path, share: float = 1.0, measure: str = "mastered_percent") -> str:
    console = Console(width=200, record=True)
    show_ranking(root, share, console, measure)
    return console.export_text()


def test_teachers_are_ranked_on_each_challenge(tmp_path: Path) -> None:
    write(tmp_path, "random", [2, 3, 2, 3], "mostly_trivial")
    write(tmp_path, "riac", [7, 8, 7, 8], "mostly_trivial")
    write(tmp_path, "adr", [1, 3, 2, 2], "mostly_trivial", level="low")
    table = ranking(load(tmp_path), measure="mastered_percent").set_index(["expert_knowledge", "teacher"])
    assert table["rank"].to_dict() == {
        ("none", "riac"): 1, ("none", "random"): 2, ("low", "random"): 1, ("low", "adr"): 2,
    }  # fmt: skip
    assert table.loc[("none", "riac"), "difference"] == 50
    assert table.loc[("none", "riac"), "p"] < 0.001
    assert ranking(load(tmp_path), share=0.5)["mastered_area_mean"].tolist() == [0, 0, 0, 0]


def test_sentences_count_challenges_after_holms_correction(tmp_path: Path) -> None:
    for challenge, mastered in (
        ("mostly_trivial", [7, 8, 7, 8]),
        ("mostly_unfeasible", [0, 1, 0, 1]),
        ("rugged_difficulty", [2, 3, 2, 3]),
    ):
        write(
            tmp_path, "random", [4, 5, 4, 5] if challenge != "rugged_difficulty" else [2, 2, 3, 3], challenge
        )
        write(tmp_path, "riac", mastered, challenge)
    assert ranking_sentences(ranking(load(tmp_path))) == [
        "Stump tracks, expert knowledge none: RIAC is better than Random on 1 of 3 challenges, worse on 1 "
        "(p < 0.05 after Holm; few seeds)."
    ]
    assert "Over 3 challenges (expert knowledge none" in shown(tmp_path)
    for teacher in ("adr", "spdl"):
        write(tmp_path, teacher, [4, 5, 4, 5], "mostly_trivial")
        write(tmp_path, teacher, [3, 4, 3, 4], "rugged_difficulty")
    (two, three) = headlines(runs_after(load(tmp_path)))
    assert two.startswith("Over 2 challenges (expert knowledge none, 2 million steps) not distinguishable")
    assert two.count("not distinguishable") == 1
    assert [name in two for name in ("ADR", "SPDL", "RIAC")] == [True, True, False]
    assert three.endswith("after Holm, few seeds.")


def test_teachers_are_set_side_by_side_on_the_challenges_that_all_have(tmp_path: Path) -> None:
    """Two sets of two challenges are two tables, each with a teacher once, the best mean first."""
    challenges = ("mostly_trivial", "mostly_unfeasible", "rugged_difficulty")
    for place, challenge in enumerate(challenges):
        write(tmp_path, "random", [2, 3, 2, 3], challenge)
        write(tmp_path, "riac", [0, 0, 2, 9], challenge)  # the middle half of its runs is below Random
        if place != 2:
            write(tmp_path, "adr", [9, 8, 9, 8], challenge)
        if place != 0:
            write(tmp_path, "spdl", [1, 0, 1, 0], challenge)
    blocks = shown(tmp_path).split("Over challenges: expert knowledge none, 2 million steps")[1:]
    tables = [[line.split()[:3] for line in block.splitlines()[2:6]] for block in blocks]
    assert [line[0] for line in tables[0][:2]] == ["RIAC", "Random"]
    assert [[line[0] for line in table[:3]] for table in tables[1:]] == [
        ["ADR", "RIAC", "Random"],
        ["RIAC", "Random", "SPDL"],
    ]
    assert tables[1][0][1] == "85.0"
    assert [block.startswith(", 2 of 3 challenges") for block in blocks] == [False, True, True]


@pytest.mark.parametrize(
    ("measure", "scale"), [("mastered_percent", "in per cent"), ("mastered_area", "arcsine")]
)
def test_the_scale_of_the_tests_and_their_family_are_said(tmp_path: Path, measure: str, scale: str) -> None:
    write(tmp_path, "riac", [7, 8, 7, 8], "mostly_trivial")
    assert "Tested" not in shown(tmp_path, measure=measure)
    write(tmp_path, "random", [2, 3, 2, 3], "mostly_trivial")
    (line,) = (line for line in shown(tmp_path, measure=measure).splitlines() if line.startswith("Tested"))
    assert scale in line
    assert "all teachers against Random" in line


def test_few_seeds_are_said_of_random_too(tmp_path: Path) -> None:
    for seed_count, teacher in ((10, "riac"), (3, "random")):
        write(tmp_path, teacher, [4, 5, 6] * 3 + [5] if seed_count == 10 else [2, 3, 4], "mostly_trivial")
    assert ranking_sentences(ranking(load(tmp_path)))[0].endswith("few seeds).")


@pytest.mark.slow
def test_estimates_over_all_challenges_and_the_area_under_the_curve(tmp_path: Path) -> None:
    for challenge in ("mostly_trivial", "mostly_unfeasible"):
        write(tmp_path, "random", [2, 3, 2, 3], challenge)
        write(tmp_path, "riac", [6, 8, 8, 10], challenge)
    runs = runs_after(load(tmp_path))
    table = overall(runs, "mastered_percent").set_index("teacher")
    assert table.index.tolist() == ["riac", "random"]
    assert table.loc["riac", ["n", "mean", "better", "worst"]].tolist() == [8, 80.0, 1.0, 60.0]
    assert table.loc["riac", ["over_25", "over_50", "over_75"]].tolist() == [1.0, 1.0, 0.75]
    # nothing until half time, then a straight line to the end
    by_area, at_end = (ranked(runs, measure) for measure in ("mastered_area", "mastered_percent"))
    assert by_area["mastered_area_mean"].tolist() == [mean / 4 for mean in at_end["mastered_percent_mean"]]
    assert by_area["difference"].dropna().tolist() == [55 / 4] * 2
    assert by_area["worst"].tolist() == [15.0, 5.0] * 2
    assert "over training" in shown(tmp_path, measure="mastered_area")
    assert "1.00 [0.63, 1.00]" in shown(tmp_path)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    write(tmp_path, "riac", [5, 6], "mostly_trivial")
    text = shown(tmp_path)
    assert "no Random to compare with" in " ".join(text.split())
    write(tmp_path, "random", [5], "diverse_students")
    assert "* diverse_students: " in shown(tmp_path)
    SyntheticCampaign(tmp_path / "empty")
    assert "No run has been evaluated" in shown(tmp_path / "empty")
