"""Results of two budgets, students or settings in one root: never one count, one block or one test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis.claims.sources import RootSource
from analysis.commands.ranking import show_ranking
from analysis.comparisons.measured import measure
from analysis.comparisons.overall import headlines, overall_rows
from analysis.comparisons.ranking import places, ranking, sentences
from analysis.comparisons.sides import duels, side_of, together
from analysis.comparisons.sides import sentences as duel_sentences
from analysis.data.frames import load
from analysis.figures.paper_figures import drawings
from analysis.measures.conditions import by_conditions
from analysis.measures.student_pools import runs_after
from tma_ray.benchmark.statements import Reading
from tma_ray.tasks import KnowledgeLevel

CHALLENGES = ("mostly_trivial", "mostly_unfeasible", "rugged_difficulty")

COUNTS = {"random": (2, 3, 2), "riac": (7, 8, 7)}


def write(root: Path, **kinds: object) -> None:
    """Writes three seeds of Random and RIAC on three challenges, under these conditions."""
    tag = "-".join(map(str, kinds.values()))
    for challenge in CHALLENGES:
        campaign = SyntheticCampaign(root, steps=int(str(kinds.get("steps", 1000))), experiment=challenge)
        for teacher, counts in COUNTS.items():
            for seed, count in enumerate(counts):
                half = [300.0] + [0.0] * 9
                returns = {campaign.steps // 2: half, campaign.steps: [300.0] * count + [0.0] * (10 - count)}
                names = {"challenge": challenge, "run_id": f"{teacher}-{challenge}-{tag}-{seed}"}
                campaign.plain_run(teacher, seed, returns, level="none", **names | kinds)


KINDS = {
    "budgets": ({"steps": 1000}, {"steps": 2000}),
    "students": ({"student": "sac"}, {"student": "ppo"}),
    "bodies": ({"embodiment": "classic_bipedal"}, {"embodiment": "spider"}),
    "physics": ({"physics_version": 1}, {"physics_version": 2}),
    "test sets": ({"test_set": "stump_tracks"}, {"test_set": "mine"}),
}


@pytest.fixture(scope="module", params=KINDS)
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every cell under two conditions."""
    root = tmp_path_factory.mktemp("root")
    for kinds in KINDS[request.param]:
        write(root, **kinds)
    return root


def test_counts_are_of_challenges(root: Path) -> None:
    frames = load(root)
    runs = runs_after(frames)
    assert [text.split(" (")[0] for text in headlines(runs)] == ["Over 3 challenges"] * 2
    said = sentences(ranking(frames))
    assert len(set(said)) == len(said) == 2
    assert all("better than Random on 3 of 3" in text for text in said)
    assert {row["n"] for row in overall_rows(runs)} == {9}


def test_every_block_has_a_title_of_its_own(root: Path) -> None:
    table = ranking(load(root))
    assert len(set(places(table))) == 6
    console = Console(width=200, record=True)
    show_ranking(root, console=console)
    titles = re.findall(r".*expert knowledge none$", console.export_text(), flags=re.MULTILINE)
    assert len(set(titles)) == len(titles) == 6


def test_comparisons_of_two_teachers_count_challenges(root: Path) -> None:
    side = side_of(load(root), "mine")
    said = duel_sentences(duels(together(side, []), ["riac"]))
    assert len(set(said)) == len(said) == 2
    assert all("on 3 of 3 challenges" in text for text in said)


def test_figures_have_a_set_for_each(root: Path) -> None:
    frames = load(root)
    tags = [tag for tag, _ in by_conditions(runs_after(frames))]
    assert len(set(tags)) == 2
    names = [drawing.name for drawing in drawings(frames, measure(frames))]
    assert len(set(names)) == len(names)
    assert sum(name.endswith("radar") for name in names) == 2


def test_claims_never_mix_conditions(root: Path) -> None:
    frames = load(root)
    source = RootSource(frames)
    assert source.note.startswith("Claims are judged by results of ")
    samples = [
        source.sample(Reading(teacher, challenge, KnowledgeLevel.NONE))
        for teacher in COUNTS
        for challenge in CHALLENGES
    ]
    cells = frames.cells.set_index("run_id")
    values = [sample.values for sample in samples if sample is not None]
    runs = [run for each in values if each is not None for run in each.index]
    assert runs
    columns = ["steps", "student", "embodiment", "physics_version", "test_set"]
    assert len(cells.loc[runs, columns].drop_duplicates()) == 1


def test_a_share_is_of_each_runs_own_budget(tmp_path: Path) -> None:
    for kinds in KINDS["budgets"]:
        write(tmp_path, **kinds)
    table = ranking(load(tmp_path), share=0.5)
    assert table["n"].tolist() == [3] * 12
    assert (table["mastered_percent_mean"] == 10).all()
    assert set(table["steps"]) == {1000, 2000}
