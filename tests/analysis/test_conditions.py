"""Results of two budgets, students or settings in one root: never one count, one block or one test."""

import re
from pathlib import Path

import pandas as pd
import pytest
from synthetic_pools import cells, pool
from synthetic_results import BOX2D_RUN, SyntheticCampaign
from views import printed

from analysis.claims.sources import RootSource
from analysis.commands.rankings import show_ranking
from analysis.comparisons.against_random import against_random, sentences_against_random
from analysis.comparisons.comparison import Measurements
from analysis.comparisons.leaderboards import overall_rows
from analysis.comparisons.pairwise import pairwise
from analysis.comparisons.sentences import challenge_titles, ranking, ranking_sentences, sentences
from analysis.comparisons.sources import comparable_runs, head_to_head, result_set
from analysis.data.frames import Frames
from analysis.data.loading import load
from analysis.figures import drawings
from analysis.measures.pooling import by_conditions, runs_after
from analysis.tables.paper_tables import table_results
from tma_ray.benchmark.claims import Reading
from tma_ray.tasks import KnowledgeLevel

CHALLENGES = ("mostly_trivial", "mostly_unfeasible")
COUNTS = {"random": (2, 3, 2), "riac": (7, 8, 7)}


def write(root: Path, tag: str = "", **kinds: object) -> None:
    """Write three seeds of Random and RIAC on two challenges, under these conditions."""
    for challenge in CHALLENGES:
        steps = int(str(kinds.get("steps", 1000)))
        campaign = SyntheticCampaign(root, steps=steps, experiment=challenge, prefix=tag)
        for teacher, counts in COUNTS.items():
            campaign.seeds(teacher, counts, half=0.5, level="none", challenge=challenge, **kinds)


KINDS: dict[str, dict[str, object]] = {
    "budgets": {"steps": 2000},
    "students": {"student": "ppo"},
    "bodies": {"embodiment": "spider"},
    "physics": {"physics_version": 2},
    "test sets": {"test_set": "mine"},
    "engines": BOX2D_RUN,
}
"""What the runs under the second condition have of their own."""


@pytest.fixture(
    scope="module",
    params=[pytest.param(kind, marks=() if kind == "budgets" else pytest.mark.slow) for kind in KINDS],
)
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every cell under two conditions."""
    root = tmp_path_factory.mktemp("root")
    write(root)
    write(root, "other", **KINDS[request.param])
    return root


@pytest.fixture(scope="module")
def frames(root: Path) -> Frames:
    return load(root)


@pytest.fixture(scope="module")
def table(frames: Frames) -> pd.DataFrame:
    return ranking(frames)


def test_counts_are_of_challenges(frames: Frames, table: pd.DataFrame) -> None:
    runs = runs_after(frames)
    beside = sentences_against_random(against_random(frames, runs))
    assert [text.split(" (")[0] for text in beside] == ["Over 2 challenges"] * 2
    said = ranking_sentences(table)
    assert len(set(said)) == len(said) == 2
    assert all("better than Random on 2 of 2" in text for text in said)
    assert {row["n"] for row in overall_rows(runs)} == {6}
    tests = pairwise(runs, "mastered_percent")
    assert set(tests["n"]) == set(tests["reference_n"]) == set(table["n"]) == {3}
    assert {n for results in table_results(frames) for n in results.rows["n"]} == {3}


def test_blocks_are_shown_with_their_titles(root: Path, table: pd.DataFrame) -> None:
    shown = printed(show_ranking, root)
    titles = re.findall(r"(.*), expert knowledge none$", shown, flags=re.MULTILINE)
    assert sorted(titles) == sorted(set(challenge_titles(table)))
    assert len(titles) == 4


def test_comparisons_of_two_teachers_count_challenges(frames: Frames) -> None:
    said = sentences(head_to_head(comparable_runs(result_set(frames, "mine"), []), ["riac"]))
    assert len(set(said)) == len(said) == 2
    assert all("on 2 of 2 challenges" in text for text in said)


@pytest.mark.slow
def test_figures_have_a_set_for_each(frames: Frames) -> None:
    tags = [tag for tag, _ in by_conditions(runs_after(frames))]
    assert len(set(tags)) == 2
    names = [drawing.name for drawing in drawings(Measurements(frames))]
    assert len(set(names)) == len(names)
    assert sum(name.endswith("radar") for name in names) == 2


def test_tags_have_only_the_phrases_that_differ() -> None:
    alike = {"student": "ppo", "test_set": "stump_tracks:every=2"}
    runs = pool(
        *cells({"random": (1, 2), "riac": (3, 4)}, **alike),
        *cells({"random": (1, 2)}, embodiment="spider", **alike),
    )
    assert [tag for tag, _ in by_conditions(runs)] == ["", "spider"]


def test_file_names_of_figures_have_no_punctuation(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path)
    for level in ("none", "low"):
        campaign.seeds("goal_gan:preset=release", (4, 5), level=level)
    names = [drawing.name for drawing in drawings(Measurements(load(tmp_path)))]
    assert "knowledge-goal_gan_preset_release" in names
    assert [name for name in names if not re.fullmatch(r"[\w-]+", name)] == []


def test_claims_never_mix_conditions(frames: Frames) -> None:
    source = RootSource(frames)
    assert source.note.startswith("Claims are judged by results of ")
    readings = [Reading(name, place, KnowledgeLevel.NONE) for name in COUNTS for place in CHALLENGES]
    samples = [source.sample(reading) for reading in readings]
    cells = frames.cells.set_index("run_id")
    runs = [run for sample in samples if sample is not None for run in sample.runs]
    assert runs
    columns = ["steps", "student", "embodiment", "physics_version", "test_set", "engine"]
    assert len(cells.loc[runs, columns].drop_duplicates()) == 1


def test_claims_about_each_environment_are_judged_by_its_own_conditions(tmp_path: Path) -> None:
    walker = {"environment": "parkour", "embodiment": "classic_bipedal", "test_set": "parkour_walking"}
    places = {"stump_tracks": {"steps": 1000}, "parkour": {"steps": 2000, **walker}}
    for environment, kinds in places.items():
        campaign = SyntheticCampaign(tmp_path, steps=kinds["steps"], experiment=environment)
        campaign.seeds("riac", (7, 8, 7), level="low", **kinds)
    source = RootSource(load(tmp_path))
    assert source.note == ""
    for environment in places:
        reading = Reading("riac", "original", KnowledgeLevel.LOW, environment, "classic_bipedal")
        sample = source.sample(reading)
        assert sample is not None
        assert sample.description.n == 3
    SyntheticCampaign(tmp_path, steps=3000, prefix="longer").seeds("riac", (9, 9), level="low")
    note = RootSource(load(tmp_path)).note
    assert note.startswith("Claims about Stump Tracks are judged by results of ")
    assert "Parkour" not in note


def test_a_share_is_of_each_runs_own_budget(tmp_path: Path) -> None:
    for steps in (1000, 2000):
        write(tmp_path, str(steps), steps=steps)
    table = ranking(load(tmp_path), share=0.5, measure="mastered_percent")
    assert table["n"].tolist() == [3] * 8
    assert table["mastered_percent_mean"].tolist() == [pytest.approx(100 / 3), 10] * 4
    assert set(table["steps"]) == {1000, 2000}
