"""Campaigns in cohorts on a real Ray, with learners on the CPU."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from cohort_in_a_thread import serving
from cramped_learner import ENOUGH_FOR, CrampedLearner
from small_runs import SCHEDULE, STUDENTS, data_files, rows
from test_campaign import campaign, corridor, execute, idle, lingering, quiet, settings

from tma_ray.campaign import execution
from tma_ray.campaign.cluster.connection import connect
from tma_ray.campaign.executors import actors
from tma_ray.campaign.executors.cohorts import Cohorts, compilation, learner_resources, room_of, stack_keys
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.options import parse_cohort
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import GIB, ROLLOUT_WORKER, ExecutionConfig, Resources, TeacherPlacement
from tma_ray.results import Committer, Store, Table
from tma_ray.runs import Cell, Placement, run_locally

WIDTH = 4
SMALL = replace(ROLLOUT_WORKER, memory_gib=0.3)


def in_cohort(what: Any, root: Path, **changes: Any) -> Any:
    return execute(
        what, root, **{"resources": Resources(), "cohort": WIDTH, "rollout_worker": SMALL, **changes}
    )


def without_ray(what: Any, root: Path) -> dict[str, bytes]:
    """Execute the runs of `what` one after the other beside one learner; return their data files."""
    with serving(root.parent, WIDTH) as beside:
        for spec in what.plan().runs:
            run_locally(spec, Committer.open(root), Placement(learner=beside))
    return data_files(root)


def sac(teacher: str) -> Cell:
    return replace(corridor(teacher), student="sac", student_hyperparameters=STUDENTS["sac"])


def slowed(folder: Path) -> Cell:
    """Return a cell of SAC whose run cannot end before a file `stopped` is in a folder."""
    teacher = lingering(folder)
    return replace(sac(teacher.teacher), teacher_hyperparameters=teacher.teacher_hyperparameters)


@pytest.mark.usefixtures("cluster")
def test_a_cohort_gives_the_files_of_runs_that_follow_one_another(tmp_path: Path) -> None:
    """Together on Ray as alone in their cohort; the teacher asks for values and trajectories."""
    short = replace(SCHEDULE, steps=1_000)
    what = replace(campaign(corridor("odd_teachers:Scrutinising"), seeds=(0, 1)), schedule=short)
    ended = in_cohort(what, tmp_path / "cohort", teachers=TeacherPlacement.INLINE)
    assert (ended.done, ended.failed) == (2, 0)
    assert data_files(tmp_path / "cohort") == without_ray(what, tmp_path / "alone")
    attempts = rows(tmp_path / "cohort", Table.ATTEMPTS)
    assert all('"cohort": 4' in row["fingerprint"] and row["outcome"] == "done" for row in attempts)


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_students_of_several_kinds_share_a_learner_wherever_their_teachers_are(tmp_path: Path) -> None:
    what = campaign(sac("riac"), corridor("misbehaving:Torchless"), sac("alp_gmm"), seeds=(0, 1))
    (tmp_path / "expected").mkdir()
    expected = without_ray(campaign(sac("riac"), sac("alp_gmm"), seeds=(0, 1)), tmp_path / "expected/root")
    for teachers in TeacherPlacement:
        root = tmp_path / teachers
        assert in_cohort(what, root, teachers=teachers).done == 6
        found = data_files(root)
        assert {path: found[path] for path in expected} == expected


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_without_memory_a_smaller_width_is_tried_and_said(tmp_path, monkeypatch, caplog):
    def cramped(*arguments: Any) -> Cohorts:
        return Cohorts(*arguments, learner_type=CrampedLearner)

    monkeypatch.setattr(execution, "Cohorts", cramped)
    what = campaign(sac("random"), seeds=(0, 1, 2))
    assert in_cohort(what, tmp_path, most_losses=0).done == 3
    assert "too little memory for a cohort of 4 runs (Unable to allocate" in caplog.text
    assert "from now on cohorts have 2 slots" in caplog.text
    attempts = sorted(rows(tmp_path, Table.ATTEMPTS), key=lambda row: row["attempt"])
    last = {row["run_id"]: row for row in attempts}
    assert all(f'"cohort": {ENOUGH_FOR}' in row["fingerprint"] for row in last.values())


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_a_stopped_cohort_leaves_checkpoints_and_continues(tmp_path: Path) -> None:
    """Both runs leave one, the learner outlives them, and another one goes on with the same bits."""
    what, root = campaign(slowed(tmp_path), seeds=(0, 1)), tmp_path / "root"
    committer = Committer(Store.open(root))
    chosen = settings(
        cohort=WIDTH, rollout_worker=SMALL, resources=Resources(), teachers=TeacherPlacement.INLINE
    )
    checkpoints = root / "checkpoints"
    runs, head = what.plan().runs, connect(None).head
    executor = RayExecutor(committer.store, chosen, head, Cohorts(chosen, head, runs, stack_keys(runs)))
    scheduler = Scheduler(committer, executor, chosen, quiet())
    ended = scheduler.execute(runs, lambda: len(list(checkpoints.glob("*/*/index.json"))) >= 2)
    (tmp_path / "stopped").touch()
    assert (ended.done, ended.stopped, ended.waiting) == (0, 2, 0)
    committer.write_cells("short", what.plan().cell_rows)
    assert in_cohort(what, root).done == 2
    assert data_files(root) == without_ray(what, tmp_path / "alone")


@pytest.mark.slow
@pytest.mark.usefixtures("cluster")
def test_a_hanging_learner_is_killed_and_replaced(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Its process is stopped when both runs have a checkpoint; they go on beside another learner."""
    what, root = campaign(slowed(tmp_path), seeds=(0, 1)), tmp_path / "root"

    def stop() -> None:
        wait_for(lambda: len({path.parent.parent for path in checkpoints(root)}) == 2)
        hanging = [each for each in psutil.Process().children(recursive=True) if is_learner(each)]
        for each in hanging:
            each.suspend()
        wait_for(lambda: any("-attempt-001" in path.parent.name for path in checkpoints(root)))
        (tmp_path / "stopped").touch()
        stopped.extend(hanging)

    stopped: list[psutil.Process] = []
    with ThreadPoolExecutor(1) as threads:
        beside = threads.submit(stop)
        ended = in_cohort(what, root, checkpoint_seconds=0.3, unreachable_seconds=2.0)
        beside.result()
    assert (ended.done, ended.failed) == (2, 0)
    assert "not answered for 2 s: it is killed, and its 2 runs resume from their checkpoints" in caplog.text
    psutil.wait_procs(stopped, timeout=30)
    assert not any(each.is_running() for each in stopped)
    assert data_files(root) == without_ray(what, tmp_path / "alone")


def checkpoints(root: Path) -> list[Path]:
    return list(root.glob("checkpoints/*/*/index.json"))


def is_learner(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        return process.cmdline()[0].startswith("ray::LearnerActor")
    return False


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)


def test_a_learner_that_is_long_at_the_same_updates_counts_as_stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actors, "TURN_POLL", 0.0)
    over, started = threading.Event(), time.monotonic()
    thread = threading.Thread(target=over.wait, daemon=True)
    thread.start()
    turns = iter([None, started, started - actors.LONGEST_TURN])
    with pytest.raises(TimeoutError, match="at the same updates for 60 minutes: its device hangs"):
        actors.wait_for_end(thread, lambda: next(turns))
    over.set()
    actors.wait_for_end(thread, lambda: None)
    assert not thread.is_alive()


def test_a_student_without_a_stacked_learner_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"'idle_student:Idle' cannot learn in a cohort.*--cohort off"):
        in_cohort(campaign(idle("random")), tmp_path / "root")
    assert not (tmp_path / "root").exists()


def test_the_width_follows_the_device_unless_it_is_given() -> None:
    shared = Resources(gpus=0.25)
    widths = {device: ExecutionConfig(device=device).width for device in ("cpu", "cuda", "cuda:0", "mps")}
    assert widths == {"cpu": 0, "cuda": 48, "cuda:0": 48, "mps": 0}
    assert ExecutionConfig(shared, "cuda").width == 0
    assert ExecutionConfig(shared, "cuda", cohort=0).per_run == shared
    assert ExecutionConfig(device="cuda").per_run == ROLLOUT_WORKER
    assert ExecutionConfig(device="cuda").placement.device == "cpu", "rollout workers act without torch"
    assert [parse_cohort(text) for text in ("16", "off")] == [16, 0]
    for changes, message in (
        ({"device": "cuda", "cohort": 0}, "no GPU is reserved"),
        ({"device": "mps", "cohort": 4}, "learns on 'cpu' or 'cuda'"),
        ({"resources": shared, "device": "cuda", "cohort": 4}, "occupies no GPU"),
        ({"cohort": -1}, "expected a whole number of slots"),
    ):
        with pytest.raises(ValueError, match=message):
            ExecutionConfig(**changes)


def test_nodes_hold_full_cohorts_or_fewer_workers() -> None:
    gpu, cpu = ExecutionConfig(device="cuda"), ExecutionConfig(cohort=4)
    shared = Resources(1.0, 1.0, 20.0)
    node = {"CPU": 16.0, "GPU": 1.0, "memory": 100.0 * GIB}
    assert room_of(node, gpu, shared) == (1, 48)
    assert room_of({**node, "CPU": 8.0}, gpu, shared) == (1, 28), "as many as the cores hold"
    assert room_of({**node, "CPU": 32.0, "GPU": 2.0}, gpu, shared) == (2, 48)
    assert room_of({**node, "memory": 30.0 * GIB}, gpu, shared) == (1, 20)
    assert room_of({"CPU": 16.0, "memory": 100.0 * GIB}, gpu, shared) == (0, 0)
    alone = Resources(1.0, 0.0, 2.0)
    assert room_of(node, cpu, alone) == (8, 4)
    assert room_of({**node, "CPU": 2.0}, cpu, alone) == (1, 4)
    assert room_of({**node, "CPU": 1.5}, cpu, alone) == (1, 2)
    assert room_of({**node, "CPU": 1.0}, cpu, alone) == (0, 0)


def test_runs_of_equal_shapes_and_settings_are_of_one_kind() -> None:
    cells = [Cell(student="ppo"), Cell(student="ppo", teacher="riac", challenge="easy"), Cell(student="sac")]
    cells += [Cell(student="ppo:epochs=3"), Cell(student="ppo", embodiment="spider")]
    runs = campaign(*cells).plan().runs
    first, second, *others = (stack_keys(runs)[spec.run_id] for spec in runs)
    assert first == second
    assert len({first, *others}) == 4
    memory = learner_resources(ExecutionConfig(cohort=48, device="cuda"), runs, stack_keys(runs)).memory_gib
    assert 4 < memory < 20


def test_only_bfloat16_is_autotuned() -> None:
    runs = {name: campaign(Cell(student=name)).plan().runs for name in ("sac", "sac:matmul_precision=medium")}
    assert [compilation(each) for each in runs.values()] == ["default", True]
    assert compilation([spec for each in runs.values() for spec in each]) == "default"
