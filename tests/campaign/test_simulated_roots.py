"""Simulated runs as a results root: what simulation gives, told apart from all else, and never twice."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.baselines import release, verify
from analysis.baselines.verification import lacking
from analysis.comparisons.leaderboards import leaderboards
from analysis.data.loading import load
from analysis.measures.pooling import runs_after
from tma_ray.campaign.simulated import SimulatedRoot, played_runs
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
    assert "runs  hours" not in printed


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
    states = frames.cells.drop_duplicates("run_id")["status"].value_counts()
    assert states.to_dict() == {"done": 2, "waiting": 16}
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
def test_the_command_writes_a_root_that_can_be_compared(root, tmp_path, monkeypatch, capsys):
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


BLOCKING = """
import os
import time
from pathlib import Path

from tma_ray.teachers import Teacher


class Blocking(Teacher):
    def start(self, *arguments):
        super().start(*arguments)
        with Path("plays").open("a") as plays:
            plays.write(f"{os.getpid()}\\n")
        if len(Path("plays").read_text().split()) == 2:
            time.sleep(3_600)

    def sample(self):
        return self.space.sample(self.rng)

    def observe(self, episode):
        return None
"""
"""A teacher that writes the process of each run to a file, and waits in the second."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sent", "code", "said"),
    [
        (signal.SIGINT, 130, ""),
        (
            signal.SIGKILL,
            1,
            "blocking:Blocking on original (expert knowledge none, seed 1); done so far: 1 run; the same",
        ),
    ],
)
def test_an_ended_simulation_continues(tmp_path: Path, sent: signal.Signals, code: int, said: str) -> None:
    (tmp_path / "blocking.py").write_text(BLOCKING)
    chosen = ["--challenges", "original", "--expert-knowledge", "none", "--seeds", "3", "--episodes", "20"]
    command = [sys.executable, "-m", "tma_ray", "simulate", "--teachers", "blocking:Blocking", *chosen]
    command += ["--results", "sim"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as simulation:
        try:
            process = _second_process(tmp_path, simulation)
            os.kill(process if sent is signal.SIGKILL else simulation.pid, sent)
            _, error = simulation.communicate(timeout=60)
        finally:
            simulation.kill()
    assert (simulation.returncode, said in error, "Traceback" in error) == (code, True, False), error
    assert len(played_runs(Results.open(tmp_path / "sim"))) == 1
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode == 0
    assert len(played_runs(Results.open(tmp_path / "sim"))) == 3
    assert len((tmp_path / "plays").read_text().split()) == 1 + 1 + 2


def _second_process(folder: Path, simulation: subprocess.Popen[str]) -> int:
    """Wait until the first run is kept and the second begun; return the process that plays it."""
    while True:
        assert simulation.poll() is None
        time.sleep(0.05)
        processes = (folder / "plays").read_text().split("\n")[:-1] if (folder / "plays").exists() else []
        if len(processes) == 2 and played_runs(Results.open(folder / "sim")):
            return int(processes[1])
