"""Attempts in processes of this machine, without Ray: alone and in a cohort."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil
import pytest
from processes import LocalExecutor
from small_runs import data_files, rows

from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.progress import Snapshot
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.results import Committer, Results, RunStatus, Table
from tma_ray.runs import Cell, Placement, RunSpec, Schedule, run_locally
from tma_ray.runs.inputs import RunInputs
from tma_ray.runs.placement import PLAYER_NICENESS
from tma_ray.students.rollout_workers import CohortSettings

HOPPER = Path(__file__).parents[2] / "examples" / "hopper.toml"
TINY = {"hidden_units": [16, 8], "steps_per_update": 100, "batch_size": 50, "epochs": 2}
pytestmark = pytest.mark.slow


def specs(seeds: int, steps: int = 2_000) -> tuple[RunSpec, ...]:
    cell = Cell(challenge="easy", student="ppo", student_hyperparameters=TINY)
    return CampaignSpec("local", (cell,), tuple(range(seeds)), Schedule(steps, steps, steps)).plan().runs


class Playing:
    """Display that notices when a run plays, and requests a stop then."""

    def __init__(self, look: Callable[[], None] = lambda: None) -> None:
        self.begun, self._look = False, look

    def update(self, snapshot: Snapshot) -> None:
        self.begun = self.begun or bool(snapshot.running)
        if self.begun:
            self._look()

    def close(self, snapshot: Snapshot) -> None:
        """Look at no ended campaign."""

    def __call__(self) -> bool:
        return self.begun


def execute(
    runs: Sequence[RunSpec],
    root: Path,
    processes: int,
    width: int = 0,
    stop: Callable[[], bool] = lambda: False,
    view: Playing | None = None,
) -> Snapshot:
    committer = Committer.open(root)
    RunInputs.of(runs).keep(committer.store)
    settings = CohortSettings(width=width) if width else None
    executor = LocalExecutor(committer.store, Placement(), processes, settings)
    quick = ExecutionConfig(poll_seconds=0.2)
    return Scheduler(committer, executor, quick, view or Playing()).execute(runs, stop)


def outcomes(root: Path) -> list[str]:
    return sorted(row["outcome"] for row in rows(root, Table.ATTEMPTS))


def test_processes_give_what_one_process_gives(tmp_path: Path) -> None:
    runs = specs(2)
    for spec in runs:
        run_locally(spec, Committer.open(tmp_path / "one"))
    assert execute(runs, tmp_path / "two", 2).done == 2
    assert data_files(tmp_path / "one") == data_files(tmp_path / "two")


def test_processes_have_the_files_that_runs_read(tmp_path: Path) -> None:
    cell = Cell(challenge="easy", embodiment=str(HOPPER), student="ppo", student_hyperparameters=TINY)
    runs = CampaignSpec("local", (cell,), (0,), Schedule(400, 400, 400)).plan().runs
    assert execute(runs, tmp_path / "results", 1).done == 1


def test_a_run_that_raises_fails_with_its_traceback_and_the_others_go_on(tmp_path: Path) -> None:
    teachers = ("misbehaving:Raising", "random")
    cells = [Cell("corridor:Corridor", "original", "", "idle_student:Idle", name) for name in teachers]
    runs = CampaignSpec("local", tuple(cells), (0,), Schedule(400, 400, 400)).plan().runs
    ended = execute(runs, tmp_path, 1)
    assert (ended.done, ended.failed) == (1, 1)
    (failed,) = [run for run in Results.open(tmp_path).runs() if run.status is RunStatus.FAILED]
    assert "a teacher's own mistake" in str(failed.error)


def test_a_killed_process_is_replaced_and_nothing_is_lost_or_doubled(tmp_path: Path) -> None:
    runs, killed = specs(1, 30_000), list[psutil.Process]()
    others = psutil.Process().children()  # of earlier tests of this process

    def kill() -> None:
        if not killed:
            killed.extend(child for child in psutil.Process().children() if child not in others)
            killed[-1].kill()

    assert execute(runs, tmp_path / "killed", 1, view=Playing(kill)).done == 1
    assert outcomes(tmp_path / "killed") == ["done", "lost"]
    execute(runs, tmp_path / "undisturbed", 1)
    assert data_files(tmp_path / "killed") == data_files(tmp_path / "undisturbed")


def test_a_cohort_stops_and_resumes_bit_for_bit(tmp_path: Path) -> None:
    """Another number of runs at a time than in the cohort that is stopped; the width is the same."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    runs, playing = specs(2, 30_000), Playing()
    assert execute(runs, whole, 2, width=2).done == 2
    assert execute(runs, parts, 1, 2, playing, playing).stopped == 1
    assert execute(runs, parts, 2, width=2).done == 2
    assert data_files(whole) == data_files(parts)
    assert {json.loads(row["fingerprint"])["cohort"] for row in rows(whole, Table.ATTEMPTS)} == {2}


def test_players_give_way_to_their_learner(tmp_path: Path) -> None:
    """Their processes play at a lower priority, the learner serves at that of its own parent."""
    above, own = {True: set[int](), False: set[int]()}, psutil.Process()

    def look() -> None:
        for process in own.children():
            above[_listens(process)].add(process.nice() - own.nice())

    playing = Playing(look)
    execute(specs(2, 10**8), tmp_path, 2, 2, playing, playing)
    assert above[True] == {0}
    assert PLAYER_NICENESS in above[False]


def test_a_learner_that_dies_costs_no_run(tmp_path: Path) -> None:
    """Both runs are lost, not failed, and go on with another learner."""
    killed: list[psutil.Process] = []

    def kill() -> None:
        if not killed:
            killed.extend(process for process in psutil.Process().children() if _listens(process))
            killed[0].kill()

    assert execute(specs(2, 30_000), tmp_path, 2, 2, view=Playing(kill)).done == 2
    assert outcomes(tmp_path) == ["done", "done", "lost", "lost"]


def _listens(process: psutil.Process) -> bool:
    return any(each.laddr.endswith("/learner") for each in process.net_connections(kind="unix"))
