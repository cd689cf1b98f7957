"""Simulated runs as a results root: what simulation gives, told apart from all else, and never twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.baselines import release, verify
from analysis.baselines.completeness import lacking
from analysis.comparisons.leaderboard import leaderboards
from analysis.data.frames import load
from analysis.measures.student_pools import runs_after
from tma_ray.campaign.releases.simulated import SimulatedRoot, played_runs
from tma_ray.cli import main
from tma_ray.results import LEAN, SIMULATED, Results, Store, verify_root
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import SimulatedRun, find_simulated_challenge, simulate
from tma_ray.testing.matrix import SimulatedCell, cells_of, run_cells, tabulate

EPISODES = 60

LEVELS = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

Played = tuple[list[SimulatedCell], list[SimulatedRun]]


@pytest.fixture(scope="module")
def played() -> Played:
    challenges = [find_simulated_challenge(name) for name in ("original", "diverse_students")]
    cells = cells_of(["random", "adr"], challenges, LEVELS)
    runs = dict.fromkeys((c.challenge, c.teacher, c.effective_level) for c in cells)
    return cells, [
        simulate(challenge, teacher, level, seed, EPISODES)
        for challenge, teacher, level in runs
        if level is not None
        for seed in range(3)
    ]


@pytest.fixture(scope="module")
def root(played: Played, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "root"
    write(folder, played)
    return folder


def write(folder: Path, played: Played) -> None:
    cells, runs = played
    root = SimulatedRoot(folder, cells, range(3), EPISODES)
    for run in runs:
        root.add(run)


def test_results_are_those_of_the_simulation(played: Played, root: Path) -> None:
    cells, runs = played
    frames = load(root)
    assert len(frames.results.runs()) == len(runs) == 2 * 3 * 3
    assert len(frames.cells) == len(cells) * 3  # Random's levels share their runs
    assert set(frames.cells["engine"]) == {SIMULATED}
    table = runs_after(frames)
    high = table[table["expert_knowledge"] == "high"]
    found = high.groupby(["challenge", "teacher"])["mastered_percent"].mean()
    for (challenge, teacher), mean in found.items():
        mine = [
            run.mastered
            for run in runs
            if (run.challenge, run.teacher) == (challenge, teacher)
            and (teacher == "random" or run.level is KnowledgeLevel.HIGH)
        ]
        assert mean == pytest.approx(np.mean(mine))


def test_a_root_is_whole_and_written_once(played: Played, root: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*.json")}
    write(root, played)
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*.json")} == before
    assert verify_root(Store.open(root)).damage == ()


def test_campaigns_cannot_repeat_it_and_say_what_can(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    like = ["campaign", "--like", str(root), "--teachers", "riac", "--results", "nowhere", "--dry-run"]
    assert main(like) == 2
    assert "tma-ray simulate --teachers NAME" in capsys.readouterr().err


def test_its_leaderboard_ranks_without_hours(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["leaderboard", str(root)]) == 0
    printed = capsys.readouterr().out
    assert "ADR" in printed
    assert "hours a run" not in printed


def test_runs_are_read_as_they_were_played(played: Played, root: Path) -> None:
    cells, runs = played
    read = played_runs(Results.open(root))
    assert len(read) == len(runs)
    pd.testing.assert_frame_equal(tabulate(cells, read), tabulate(cells, runs))
    some = {manifest.run.run_id for manifest in Results.open(root).runs()[:2]}
    assert len(played_runs(Results.open(root), some)) == 2


def test_what_was_interrupted_is_continued(played: Played, tmp_path: Path) -> None:
    cells, runs = played
    asked = tmp_path / "root", cells, range(3), EPISODES
    begun = SimulatedRoot(*asked)
    assert begun.kept() == []
    begun.add(runs[0])
    begun.add(runs[5])
    frames = load(tmp_path / "root")
    assert frames.cells.drop_duplicates("run_id")["status"].value_counts().to_dict() == {
        "done": 2,
        "waiting": 16,
    }
    kept = SimulatedRoot(*asked).kept()
    names = [(run.challenge, run.teacher, run.level, run.seed) for run in kept]
    assert set(names) == {(run.challenge, run.teacher, run.level, run.seed) for run in (runs[0], runs[5])}
    others = list(run_cells(cells, range(3), EPISODES, 1, kept))
    assert len(others) == 16
    mastered = tabulate(cells, [*kept, *others])["mastered_percent"]
    np.testing.assert_array_equal(mastered, tabulate(cells, runs)["mastered_percent"])


@pytest.mark.slow
def test_it_can_be_released_and_is_complete(root: Path, tmp_path: Path) -> None:
    place = release(root, "simulated-x", tmp_path, "CC0-1.0", contents=LEAN)
    found = verify(place)
    assert found.whole
    assert lacking(found.baseline) == []
    assert found.baseline.manifest.engine == SIMULATED
    assert "without physics" in (place / "README.md").read_text()
    assert {board.title.split(",")[0] for board in leaderboards(load(place))} == {
        "expert knowledge low", "expert knowledge high",
    }  # fmt: skip


@pytest.mark.slow
def test_the_command_writes_a_root_that_can_be_compared(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "middle.py").write_text(
        "from tma_ray.teachers import Teacher\n\n\n"
        "class Middle(Teacher):\n    def sample(self):\n        return self.space.sample(self.rng)\n\n"
        "    def observe(self, episode):\n        return None\n"
    )
    arguments = ["--challenges", "original,diverse_students", "--expert-knowledge", "high", "--seeds", "3"]
    command = ["simulate", "--teachers", "middle:Middle", *arguments, "--episodes", str(EPISODES)]
    assert main([*command, "--results", "mine"]) == 0
    (manifest, *_) = Results.open("mine").runs()
    assert "middle" in manifest.run.spec
    assert list((tmp_path / "mine" / "inputs").glob("plugin-*.json"))
    capsys.readouterr()
    assert main(["compare", "mine", "--baseline", str(root)]) == 0
    assert "middle:Middle ranks" in capsys.readouterr().out
