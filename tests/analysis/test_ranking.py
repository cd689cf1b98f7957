"""Who masters most on each challenge and over all of them, and what may be said of it."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic_pools import cell, pool
from synthetic_results import SyntheticCampaign
from views import printed

from analysis.commands.rankings import show_ranking
from analysis.comparisons.against_random import against_random, sentences_against_random
from analysis.comparisons.aggregates import stratified_means
from analysis.comparisons.leaderboards import overall, overall_rows, performance_profiles
from analysis.comparisons.ranks import ranks
from analysis.comparisons.sentences import ranked, ranking, ranking_sentences
from analysis.data.loading import load
from analysis.measures.pooling import runs_after
from analysis.measures.tested import PAPERS
from analysis.statistics import percent_interval


def write(root: Path, teacher: str, mastered: list[int], challenge: str, level: str = "none") -> None:
    """Write finished runs that master so many of ten test tasks in the end, and none at half time."""
    campaign = SyntheticCampaign(root, experiment=challenge)
    campaign.seeds(teacher, mastered, half=0.0, level=level, challenge=challenge)


def shown(root: Path, measure: str = "mastered_percent", *, explain: bool = False) -> str:
    return printed(show_ranking, root, measure=measure, explain=explain, width=100)


def test_teachers_are_ranked_on_each_challenge(tmp_path: Path) -> None:
    write(tmp_path, "random", [2, 3, 2, 3], "mostly_trivial")
    write(tmp_path, "riac", [7, 8, 7, 8], "mostly_trivial")
    write(tmp_path, "adr", [1, 3, 2, 2], "mostly_trivial", level="low")
    table = ranking(load(tmp_path), measure="mastered_percent").set_index(["expert_knowledge", "teacher"])
    assert table.loc["none", "rank"].to_dict() == {"riac": 1, "random": 2}
    assert table.loc["low", "rank"].to_dict() == {"random": 1, "adr": 2}
    assert table.loc[("none", "riac"), "difference"] == 50
    assert table.loc[("none", "riac"), "p"] < 0.001
    assert ranking(load(tmp_path), share=0.5)["mastered_area_mean"].tolist() == [0, 0, 0, 0]


def test_sentences_count_challenges_after_holms_correction(tmp_path: Path) -> None:
    for challenge, random, riac in (
        ("mostly_trivial", [4, 5, 4, 5], [7, 8, 7, 8]),
        ("mostly_unfeasible", [4, 5, 4, 5], [0, 1, 0, 1]),
        ("rugged_difficulty", [2, 2, 3, 3], [2, 3, 2, 3]),
    ):
        write(tmp_path, "random", random, challenge)
        write(tmp_path, "riac", riac, challenge)
    assert ranking_sentences(ranking(load(tmp_path))) == [
        "Stump Tracks, expert knowledge none: RIAC is better than Random on 1 of 3 challenges, worse on 1 "
        "(p < 0.05 after Holm; few seeds)."
    ]
    assert "Over 3 challenges (expert knowledge none" in shown(tmp_path, explain=True)
    for teacher in ("adr", "spdl"):
        write(tmp_path, teacher, [4, 5, 4, 5], "mostly_trivial")
        write(tmp_path, teacher, [3, 4, 3, 4], "rugged_difficulty")
    frames = load(tmp_path)
    (two, three) = sentences_against_random(against_random(frames, runs_after(frames)))
    assert two.startswith("Over 2 challenges (expert knowledge none, 2 million steps), beside Random: ")
    assert [name in two for name in ("ADR", "SPDL", "RIAC")] == [True, True, False]
    assert three.endswith("in the end, few seeds).")


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
    blocks = re.split(r"^Over \d challenges: ", shown(tmp_path, explain=True), flags=re.MULTILINE)[1:]
    tables = [[line.split()[:2] for line in block.split("rank\n")[1].splitlines()[:3]] for block in blocks]
    assert [[name for name, _ in table[:2]] for table in tables[:1]] == [["RIAC", "Random"]]
    names = [[name for name, _ in table] for table in tables[1:]]
    assert names == [["ADR", "RIAC", "Random"], ["RIAC", "Random", "SPDL"]]
    assert [" on 2 of 3" in block for block in blocks] == [False, True, True]
    assert len(re.findall(r"^Over \d challenges: ", shown(tmp_path), flags=re.MULTILINE)) == 1


@pytest.mark.parametrize("measure", ["mastered_percent", "mastered_area"])
def test_the_table_comes_first_and_definitions_on_demand(tmp_path: Path, measure: str) -> None:
    for challenge in ("mostly_trivial", "mostly_unfeasible"):
        write(tmp_path, "riac", [7, 8, 7, 8], challenge)
        write(tmp_path, "random", [2, 3, 2, 3], challenge)
    text = shown(tmp_path, measure=measure)
    assert "The best teacher" in text.splitlines()[1]
    assert max(map(len, text.splitlines())) <= 100
    assert "Holm's correction" not in text
    explained = shown(tmp_path, measure=measure, explain=True)
    assert explained.startswith(text)
    assert "Holm's correction covers on each challenge the core against Random" in " ".join(explained.split())


def test_without_random_teachers_are_ranked_and_not_compared_with_it(tmp_path: Path) -> None:
    for challenge in ("mostly_trivial", "mostly_unfeasible"):
        write(tmp_path, "riac", [7, 8, 7, 8], challenge)
        write(tmp_path, "adr", [2, 3, 2, 3], challenge)
    table = shown(tmp_path).partition("rank\n")[2].splitlines()
    assert [line.split()[:3] for line in table[:2]] == [["RIAC", "37.5", "1"], ["ADR", "12.5", "2"]]
    assert "no spread" not in shown(tmp_path, explain=True)


def test_few_seeds_are_said_of_random_too(tmp_path: Path) -> None:
    write(tmp_path, "riac", [4, 5, 6] * 3 + [5], "mostly_trivial")
    write(tmp_path, "random", [2, 3, 4], "mostly_trivial")
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
    assert "1.00 [0.63, 1.00]" in {row["better"] for row in overall_rows(runs, "mastered_percent")}


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    write(tmp_path, "riac", [5, 6], "mostly_trivial")
    text = shown(tmp_path)
    assert "no Random to compare with" in " ".join(text.split())
    write(tmp_path, "random", [5], "diverse_students")
    assert "* diverse_students: " in shown(tmp_path)
    SyntheticCampaign(tmp_path / "empty")
    assert "No run has been evaluated" in shown(tmp_path / "empty")


CHALLENGES = ("original", "mostly_trivial", "rugged_difficulty")


def runs_of(results: dict[str, dict[str, list[float]]]) -> pd.DataFrame:
    rows = (
        cell(teacher, seed, value, challenge=challenge, experiment=challenge)
        for teacher, challenges in results.items()
        for challenge, values in challenges.items()
        for seed, value in enumerate(values)
    )
    return pool(*rows)


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    def around(*means: float) -> dict[str, list[float]]:
        return {name: [m - 1, m, m + 1] for name, m in zip(CHALLENGES, means, strict=False)}

    results = {"random": around(10, 10, 10), "good": around(30, 40, 50), "near": around(31, 39, 49)}
    return runs_of(results | {"bad": around(1, 2, 3), "part": around(90, 90)})


def test_ranks_are_by_the_mean_over_challenges_and_certain_as_far_as_tests_go(runs: pd.DataFrame) -> None:
    found = {rank.teacher: rank for rank in ranks(runs)}
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
    assert "near ranks 2 of 4 by mean (sooner), and the tests leave 1 to 2 open" in only.describe()
    assert "lacking challenges: 1 (part)" in only.describe()


def test_who_is_not_ranked_is_not_in_the_family() -> None:
    results = {
        "random": {"original": [10.0, 12.0, 14.0], "mostly_trivial": [10.0, 12.0, 14.0]},
        "near": {"original": [13.7, 14.7, 15.7], "mostly_trivial": [13.2, 14.2, 15.2]},
    }
    (alone,) = ranks(runs_of(results), ["near"])
    more = runs_of({**results, **{f"part{k}": {"original": [14.0, 15.0, 16.0]} for k in range(5)}})
    (beside,) = ranks(more, ["near"])
    assert alone.better == beside.better == ("random",)
    assert len(beside.left_out) == 5
    (whole,) = ranks(runs_of({**results, "other": results["near"]}), ["near"])
    assert whole.better == (), "a second pair of the family takes what was just significant"


def test_the_interval_of_the_mean_has_welch_and_satterthwaites_error() -> None:
    rng = np.random.default_rng(3)
    values = {name: list(rng.normal(50, std, 5)) for name, std in zip(CHALLENGES, (1, 5, 20), strict=True)}
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
