"""Results of two budgets, students or settings in one root: never one count, one block or one test."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis.claims.judging import RootSource
from analysis.commands.rankings import show_ranking
from analysis.comparisons.boards import headlines, overall_rows
from analysis.comparisons.measured import measure
from analysis.comparisons.sentences import places, ranking, ranking_sentences, sentences
from analysis.comparisons.sides import duels, side_of, together
from analysis.data.frames import Frames, load
from analysis.figures import drawings
from analysis.measures.pooling import by_conditions, runs_after
from tma_ray.benchmark.claims import Reading
from tma_ray.tasks import KnowledgeLevel

CHALLENGES = ("mostly_trivial", "mostly_unfeasible")

COUNTS = {"random": (2, 3, 2), "riac": (7, 8, 7)}


def write(root: Path, **kinds: object) -> None:
    """Write three seeds of Random and RIAC on two challenges, under these conditions."""
    tag = "-".join(map(str, kinds.values()))
    for challenge in CHALLENGES:
        campaign = SyntheticCampaign(root, steps=int(str(kinds.get("steps", 1000))), experiment=challenge)
        for teacher, counts in COUNTS.items():
            for seed, count in enumerate(counts):
                half = [300.0] + [0.0] * 9
                returns = {campaign.steps // 2: half, campaign.steps: [300.0] * count + [0.0] * (10 - count)}
                names = {"challenge": challenge, "run_id": f"{teacher}-{challenge}-{tag}-{seed}"}
                campaign.plain_run(teacher, seed, returns, level="none", **names | kinds)


KINDS: dict[str, dict[str, object]] = {
    "budgets": {"steps": 2000},
    "students": {"student": "ppo"},
    "bodies": {"embodiment": "spider"},
    "physics": {"physics_version": 2},
    "test sets": {"test_set": "mine"},
}
"""What the runs under the second condition have of their own."""

SHORT = pytest.mark.parametrize(
    "root",
    [pytest.param(kind, marks=() if kind == "budgets" else pytest.mark.slow) for kind in KINDS],
    indirect=True,
)
"""One kind among the fast tests, all among the slow ones."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every cell under the conditions that all kinds have first."""
    root = tmp_path_factory.mktemp("plain")
    write(root, student="sac")
    return root


FAST = ("budgets",)


@pytest.fixture(
    scope="module",
    params=[pytest.param(kind, marks=() if kind in FAST else pytest.mark.slow) for kind in KINDS],
)
def root(request: pytest.FixtureRequest, plain: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every cell under two conditions."""
    root = tmp_path_factory.mktemp("root") / "root"
    shutil.copytree(plain, root)
    write(root, **KINDS[request.param])
    return root


@pytest.fixture(scope="module")
def frames(root: Path) -> Frames:
    return load(root)


@pytest.fixture(scope="module")
def table(frames: Frames) -> pd.DataFrame:
    return ranking(frames)


def test_counts_are_of_challenges(frames: Frames, table: pd.DataFrame) -> None:
    runs = runs_after(frames)
    assert [text.split(" (")[0] for text in headlines(runs)] == ["Over 2 challenges"] * 2
    said = ranking_sentences(table)
    assert len(set(said)) == len(said) == 2
    assert all("better than Random on 2 of 2" in text for text in said)
    assert {row["n"] for row in overall_rows(runs)} == {6}


def test_every_block_has_a_title_of_its_own(table: pd.DataFrame) -> None:
    assert len(set(places(table))) == 4


@SHORT
def test_blocks_are_shown_with_their_titles(root: Path, table: pd.DataFrame) -> None:
    console = Console(width=200, record=True)
    show_ranking(root, console=console)
    titles = re.findall(r"(.*), expert knowledge none$", console.export_text(), flags=re.MULTILINE)
    assert sorted(titles) == sorted(set(places(table)))


def test_comparisons_of_two_teachers_count_challenges(frames: Frames) -> None:
    said = sentences(duels(together(side_of(frames, "mine"), []), ["riac"]))
    assert len(set(said)) == len(said) == 2
    assert all("on 2 of 2 challenges" in text for text in said)


@pytest.mark.slow
@SHORT
def test_figures_have_a_set_for_each(frames: Frames) -> None:
    tags = [tag for tag, _ in by_conditions(runs_after(frames))]
    assert len(set(tags)) == 2
    names = [drawing.name for drawing in drawings(frames, measure(frames))]
    assert len(set(names)) == len(names)
    assert sum(name.endswith("radar") for name in names) == 2


def test_claims_never_mix_conditions(frames: Frames) -> None:
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
    for steps in (1000, 2000):
        write(tmp_path, steps=steps)
    table = ranking(load(tmp_path), share=0.5, measure="mastered_percent")
    assert table["n"].tolist() == [3] * 8
    assert (table["mastered_percent_mean"] == 10).all()
    assert set(table["steps"]) == {1000, 2000}
