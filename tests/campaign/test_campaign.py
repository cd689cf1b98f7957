"""Campaigns of short real runs on a real Ray."""

import io
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import ray
from rich.console import Console
from small_runs import SCHEDULE, STUDENTS, data_files, rows

from tma_ray.campaign import Campaign
from tma_ray.campaign.cluster.connection import connect
from tma_ray.campaign.execution import execute_plan
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.progress import ProgressView, Snapshot, overview
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig, Resources, TeacherPlacement
from tma_ray.curriculum import Curriculum, SharedCurriculum
from tma_ray.results import Committer, Lease, Results, RootInUseError, Store, Table
from tma_ray.runs import Cell, run_locally
from tma_ray.tasks import KnowledgeLevel

pytestmark = pytest.mark.usefixtures("cluster")


def corridor(teacher: str, level: KnowledgeLevel = KnowledgeLevel.NONE, **hyperparameters: Any) -> Cell:
    settings = {"teacher_hyperparameters": hyperparameters, "student_hyperparameters": STUDENTS["ppo"]}
    return Cell("corridor:Corridor", "original", "", "ppo", teacher, level, **settings)


def idle(teacher: str, level: KnowledgeLevel = KnowledgeLevel.NONE) -> Cell:
    """Return a cell in which nothing is learned, and which starts sooner for that."""
    return replace(corridor(teacher, level), student="idle_student:Idle", student_hyperparameters={})


def lingering(folder: Path) -> Cell:
    """Return a cell whose run cannot end before a file `stopped` is in a folder."""
    settings = {"region_capacity": 20, "folder": str(folder)}
    return replace(idle("misbehaving:Lingering"), teacher_hyperparameters=settings)


def campaign(*cells: Cell, seeds: tuple[int, ...] = (0,)) -> Campaign:
    return Campaign("short", cells, seeds, SCHEDULE)


def settings(**changes: Any) -> ExecutionConfig:
    return ExecutionConfig(**{"resources": Resources(memory_gib=0.5), "poll_seconds": 0.1, **changes})


def quiet() -> ProgressView:
    return ProgressView(Console(file=io.StringIO()))


def execute(what: Campaign, root: Path, **changes: Any) -> Snapshot:
    return execute_plan(what.plan(), root, settings(**changes), view=quiet())


def alone(what: Campaign, root: Path) -> dict[str, bytes]:
    """Execute the runs of `what` one after the other in this process; return their data files."""
    for spec in what.plan().runs:
        run_locally(spec, Committer.open(root))
    return data_files(root)


@pytest.mark.parametrize(
    "cells",
    [
        [idle("odd_teachers:Scrutinising")],
        pytest.param([idle("random"), corridor("riac", region_capacity=20)], marks=pytest.mark.slow),
    ],
    ids=["one", "several"],
)
def test_actors_give_the_files_of_a_run_in_one_process(tmp_path: Path, cells: list[Cell]) -> None:
    what, count = campaign(*cells), len(cells)
    ended = execute(what, tmp_path / "actors", checkpoint_seconds=0.5)
    assert (ended.done, ended.failed, ended.total) == (count, 0, count)
    expected = alone(what, tmp_path / "alone")
    assert len(expected) == 5 * count
    assert data_files(tmp_path / "actors") == expected
    attempts = rows(tmp_path / "actors", Table.ATTEMPTS)
    assert [(row["outcome"], row["attempt"]) for row in attempts] == [("done", 0)] * count
    assert all(row["env_steps_per_second"] > 0 and row["host"] for row in attempts)


def test_a_teacher_that_cannot_start_is_no_loss(tmp_path: Path) -> None:
    """An actor whose constructor raises counts as dead: its run was repeated three times."""
    ended = execute(campaign(idle("misbehaving:Unstartable")), tmp_path)
    assert (ended.done, ended.failed) == (0, 1)
    assert [row["outcome"] for row in rows(tmp_path, Table.ATTEMPTS)] == ["failed"]
    (failed,) = Results.open(tmp_path).runs()
    assert "a teacher's own mistake at its start" in str(failed.error)


@pytest.mark.slow
def test_cells_share_runs_and_running_again_does_only_what_is_missing(tmp_path: Path) -> None:
    cells = [idle("random", level) for level in (KnowledgeLevel.NONE, KnowledgeLevel.LOW)]
    assert len(campaign(*cells).plan().runs) == 1
    execute(campaign(*cells), tmp_path, teachers=TeacherPlacement.INLINE)
    shared = rows(tmp_path, Table.CELLS)
    assert [cell["expert_knowledge"] for cell in shared] == ["low", "none"]
    assert len({cell["run_id"] for cell in shared}) == 1
    again = execute(campaign(*cells, seeds=(0, 1)), tmp_path, teachers=TeacherPlacement.INLINE)
    assert again.done == 2
    attempts = rows(tmp_path, Table.ATTEMPTS)
    assert sorted((row["attempt"], row["outcome"]) for row in attempts) == [(0, "done"), (0, "done")]
    cells_now = overview(tmp_path, time.time()).campaigns["short"]
    assert {state.state for runs in cells_now.values() for state in runs} == {"done"}


@pytest.mark.slow
def test_a_damaged_run_is_done_again_and_nothing_else(tmp_path: Path) -> None:
    what, root = campaign(corridor("random"), corridor("alp_gmm")), tmp_path / "root"
    execute(what, root)
    before = data_files(root)
    first, second, *_ = sorted(path.stem for path in (root / "manifests").iterdir())
    manifest, table = root / f"manifests/{first}.json", root / f"tables/episodes/{second}.parquet"
    manifest.write_bytes(manifest.read_bytes()[:100])
    table.write_bytes(table.read_bytes()[:100])
    (root / "lease.json").write_text("{}")
    (root / "stop.json").write_text("[]")
    assert execute(what, root).done == len(what.plan().runs)
    assert data_files(root) == before
    attempts = [(row["run_id"], row["attempt"]) for row in rows(root, Table.ATTEMPTS)]
    assert {run for run, attempt in attempts if attempt == 1} == {first, second}


def test_a_stopped_campaign_leaves_checkpoints_and_continues(tmp_path: Path) -> None:
    what = campaign(lingering(tmp_path))
    committer = Committer(Store.open(tmp_path / "root"))
    inline = settings(teachers=TeacherPlacement.INLINE)
    head = connect(None).head
    executor = RayExecutor(committer.store, inline, head)
    scheduler = Scheduler(committer, executor, inline, quiet())
    checkpoints = tmp_path / "root" / "checkpoints"
    ended = scheduler.execute(what.plan().runs, lambda: any(checkpoints.rglob("index.json")))
    (tmp_path / "stopped").touch()
    assert (ended.done, ended.stopped, ended.waiting) == (0, 1, 0)
    assert [row["outcome"] for row in rows(tmp_path / "root", Table.ATTEMPTS)] == ["stopped"]
    committer.write_cells("short", what.plan().cell_rows)
    ((state,),) = overview(tmp_path / "root", time.time()).campaigns["short"].values()
    assert state.state == "interrupted"
    assert 0 < state.step < SCHEDULE.steps
    assert execute(what, tmp_path / "root", teachers=TeacherPlacement.ACTOR).done == 1
    assert len(rows(tmp_path / "root", Table.TEACHER_LOG)) > 3
    assert data_files(tmp_path / "root") == alone(what, tmp_path / "undisturbed")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"resources": Resources(cpus=64)}, "no node can hold a run of 64 CPUs"),
        ({"resources": Resources(gpus=1, memory_gib=0.5), "device": "cuda"}, "1 GPUs|torch finds none"),
        ({"resources": Resources(memory_gib=10_000)}, "10000 GiB"),
    ],
)
def test_impossible_resources_are_refused_before_anything_starts(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        execute(campaign(corridor("random")), tmp_path / "root", **changes)
    assert not (tmp_path / "root").exists()


def test_a_second_campaign_on_the_same_root_is_refused(tmp_path: Path) -> None:
    store = Committer.open(tmp_path).store
    with Lease(store, "the first one"), pytest.raises(RootInUseError, match="the first one"):
        execute(campaign(corridor("random")), tmp_path)


@pytest.mark.slow
def test_a_plugin_that_the_workers_lack_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "from tma_ray.teachers.random import Random\nclass Mine(Random): ...\n"
    (tmp_path / "only_here.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"no module 'only_here'.*Ray was connected before"):
        execute(campaign(corridor("only_here:Mine")), tmp_path / "root")
    assert not (tmp_path / "root").exists()


def set_mass(environment: gymnasium.Env, task: dict[str, float]) -> None:
    environment.unwrapped.m = task["mass"]


class Worker:
    """An actor with an environment of its own."""

    def __init__(self, handle: SharedCurriculum) -> None:
        self.environment = handle.wrap(gymnasium.make("Pendulum-v1", max_episode_steps=5), set_mass)

    def play(self, episodes: int) -> list[float]:
        """Return the masses of so many episodes, and begin another one."""
        masses = [float(self.environment.reset(seed=0)[1]["task"][0])]
        for _ in range(episodes):
            while not self.environment.step(np.zeros(1, np.float32))[3]:
                pass
            masses.append(float(self.environment.reset()[1]["task"][0]))
        return masses[:-1]


def test_actors_share_a_teacher_and_one_that_dies_costs_its_episode_only(cluster: None) -> None:
    curriculum = Curriculum("riac", {"mass": (0.5, 2.0)}, mastery_return=-50)
    handle = curriculum.shared(host="127.0.0.1")
    first, second = (ray.remote(num_cpus=0)(Worker).remote(handle) for _ in range(2))
    played = ray.get([first.play.remote(3), second.play.remote(3)])
    ray.kill(first)
    played.append(ray.get(second.play.remote(2)))
    assert sorted(np.concatenate(played)) == sorted(curriculum.episodes["task_mass"])
    assert curriculum.episodes["length"].tolist() == [5] * 8
