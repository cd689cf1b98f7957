"""Runs in processes of this machine, without Ray: alone and in a cohort."""

from __future__ import annotations

import json
from pathlib import Path

import psutil
import pytest

from tma_ray.campaign.executors.processes import PoolReport, cohort, run_in_processes
from tma_ray.campaign.plan import CampaignSpec
from tma_ray.results import AttemptOutcome, Results, Table
from tma_ray.runs import Cell, Placement, RunSpec, Schedule
from tma_ray.runs.placement import PLAYER_NICENESS
from tma_ray.students.players import CohortSettings

HOPPER = Path(__file__).parents[2] / "examples" / "hopper.toml"

TINY = {"hidden_units": [16, 8], "steps_per_update": 100, "batch_size": 50, "epochs": 2}

pytestmark = pytest.mark.slow


def specs(seeds: int, steps: int = 2_000) -> tuple[RunSpec, ...]:
    cell = Cell(challenge="easy", student="ppo", student_hyperparameters=TINY)
    return CampaignSpec("pool", (cell,), tuple(range(seeds)), Schedule(steps, steps, steps)).plan().runs


def episodes(root: Path) -> list[dict[str, object]]:
    rows = Results.open(root).table(Table.EPISODES).to_pandas()
    rows["task"], rows["world_task"] = rows.task.map(tuple), rows.world_task.map(str)
    return rows.sort_values(["run_id", "step"]).to_dict(orient="records")


class Playing:
    """Notices that a run has played its first episode."""

    def __init__(self) -> None:
        self.begun = False

    def look(self, report: PoolReport) -> None:
        self.begun = self.begun or bool(report.steps)

    def __call__(self) -> bool:
        return self.begun


def test_a_pool_gives_what_one_process_gives(tmp_path: Path) -> None:
    for processes in (1, 2):
        report = run_in_processes(specs(2), tmp_path / str(processes), processes)
        assert set(report.outcomes.values()) == {AttemptOutcome.DONE}
        assert not report.errors
    assert episodes(tmp_path / "1") == episodes(tmp_path / "2")


def test_processes_have_the_files_that_runs_read(tmp_path: Path) -> None:
    cell = Cell(challenge="easy", embodiment=str(HOPPER), student="ppo", student_hyperparameters=TINY)
    runs = CampaignSpec("pool", (cell,), (0,), Schedule(400, 400, 400)).plan().runs
    report = run_in_processes(runs, tmp_path / "results", 1)
    assert set(report.outcomes.values()) == {AttemptOutcome.DONE}, report.errors


def test_a_cohort_stops_and_resumes_bit_for_bit(tmp_path: Path) -> None:
    """Another number of runs at a time than in the cohort that is stopped; the width is the same."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    runs, playing = specs(2, 30_000), Playing()
    with cohort(CohortSettings(width=2)) as learner:
        report = run_in_processes(runs, whole, 2, Placement(learner=learner))
    assert list(report.outcomes.values()) == 2 * [AttemptOutcome.DONE]
    with cohort(CohortSettings(width=2)) as learner:
        stopped = run_in_processes(runs, parts, 1, Placement(learner=learner), playing, playing.look)
    assert list(stopped.outcomes.values()) == [AttemptOutcome.STOPPED]
    with cohort(CohortSettings(width=2)) as learner:
        run_in_processes(runs, parts, 2, Placement(learner=learner))
    assert episodes(whole) == episodes(parts)
    attempts = Results.open(whole).table(Table.ATTEMPTS).to_pandas()
    assert {json.loads(each)["cohort"] for each in attempts.fingerprint} == {2}


def test_players_give_way_to_their_learner(tmp_path: Path) -> None:
    """Their processes play at a lower priority, the learner serves at that of its own parent."""
    playing, above, own = Playing(), {True: set[int](), False: set[int]()}, psutil.Process()
    with cohort(CohortSettings(width=2)) as learner:

        def look(report: PoolReport) -> None:
            playing.look(report)
            for process in own.children() if playing() else ():
                above[_listens(process, learner.address)].add(process.nice() - own.nice())

        run_in_processes(specs(2, 10**8), tmp_path, 2, Placement(learner=learner), playing, look)
    assert above[True] == {0}
    assert PLAYER_NICENESS in above[False]


def test_a_learner_that_dies_costs_no_run(tmp_path: Path) -> None:
    """Both runs are lost, not failed, and the next call takes them up."""
    runs, playing = specs(2, 10**8), Playing()
    with cohort(CohortSettings(width=2)) as learner:

        def kill() -> bool:
            for process in psutil.Process().children() if playing() else ():
                if _listens(process, learner.address):
                    process.kill()
            return False

        report = run_in_processes(runs, tmp_path, 2, Placement(learner=learner), kill, playing.look)
    assert list(report.outcomes.values()) == 2 * [AttemptOutcome.LOST]
    again = Playing()
    with cohort(CohortSettings(width=2)) as learner:
        report = run_in_processes(runs, tmp_path, 2, Placement(learner=learner), again, again.look)
    assert set(report.outcomes.values()) == {AttemptOutcome.STOPPED}


def _listens(process, address: str) -> bool:
    return any(each.laddr == address for each in process.net_connections(kind="unix"))
