"""Status, history and rerun of campaigns, and stopping them, from what lies in the results root."""

import io
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import copytree

import pytest
from rich.console import Console
from small_runs import SCHEDULE, rows
from test_campaign import campaign, execute, idle, lingering, settings

from tma_ray.campaign import progress
from tma_ray.campaign.execution import execute_plan
from tma_ray.campaign.progress import Observer, Snapshot, overview
from tma_ray.campaign.repeating import rerun_plan
from tma_ray.campaign.settings import TeacherPlacement
from tma_ray.results import (
    Committer,
    Heartbeat,
    LearnerProgress,
    NotRunningError,
    Results,
    RunProgress,
    RunStatus,
    Store,
    Table,
    ask_to_stop,
)
from tma_ray.runs import run_locally


def printed(show: Callable[[Console], object]) -> str:
    text = io.StringIO()
    show(Console(file=text, width=200))
    return text.getvalue()


def shown(root: Path, *, cells: bool = False) -> str:
    return printed(partial(progress.show_status, root, cells))


@pytest.fixture(scope="module")
def failed_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a root in which a run has finished and another failed, for lack of a file beside it."""
    folder = tmp_path_factory.mktemp("failed")
    waiting = replace(idle("misbehaving:Waiting"), teacher_hyperparameters={"folder": str(folder)})
    what, root = campaign(idle("random"), waiting), folder / "root"
    committer = Committer.open(root)
    committer.write_cells("short", what.plan().cell_rows)
    good, bad = what.plan().runs
    run_locally(good, committer)
    with pytest.raises(FileNotFoundError):
        run_locally(bad, committer)
    return folder


@pytest.fixture
def one_failed(failed_once: Path, tmp_path: Path) -> Path:
    """That root, copied; without Ray."""
    return copytree(failed_once / "root", tmp_path / "root")


def test_status_counts_runs_and_tells_what_failed_and_what_to_do(one_failed: Path) -> None:
    text = shown(one_failed)
    assert "No campaign has given a sign of life" in text
    assert "campaign short: 1/2 runs done" in text
    (line,) = (line for line in text.splitlines() if line.startswith("corridor:Corridor"))
    assert line.split()[-3:] == ["1", "1", f"{SCHEDULE.steps:,}"], "done, failed, steps of both teachers"
    assert "needed is missing" in text
    assert "tma-ray logs" in text
    assert f"tma-ray rerun {one_failed} --failed" in text
    assert "misbehaving:Waiting" in shown(one_failed, cells=True)


def test_status_tells_speed_and_time_left_of_a_living_campaign(one_failed: Path) -> None:
    store = Store.open(one_failed)
    (failed,) = (m for m in Results(store).runs() if m.status is RunStatus.FAILED)
    Committer(store).start(failed.run)
    now = time.time()
    learner = LearnerProgress("node-1", "cuda", 48, 40, 5_000.0, 0.7, 21.5, 79.2)
    runs = {failed.run.run_id: RunProgress(100, 50.0)}
    Heartbeat("campaign 'short' on head-1", now - 5, runs, learners=(learner,)).write(store)
    text = shown(one_failed)
    assert "learner on node-1, cuda: 40 of 48 slots, 5,000 updates/s, busy 70%, 21.5 of 79.2 GiB" in text
    assert "Running: campaign 'short' on head-1; last heartbeat 5 s ago" in text
    assert f"50 steps/s, about {(SCHEDULE.steps - 100) // 50} s left" in text
    states = [state for runs in overview(one_failed, now).campaigns["short"].values() for state in runs]
    assert sorted((state.state, state.steps_per_second) for state in states) == [("done", 0), ("running", 50)]
    later = [s for runs in overview(one_failed, now + 1000).campaigns["short"].values() for s in runs]
    assert {state.steps_per_second for state in later} == {0}, "a dead campaign has no speed"


@pytest.mark.slow
def test_thousands_of_failures_stay_readable(tmp_path: Path) -> None:
    committer = Committer.open(tmp_path)
    plan = campaign(idle("random"), seeds=tuple(range(100))).plan()
    committer.write_cells("short", plan.cell_rows)
    for index, spec in enumerate(plan.runs):
        number = committer.start(spec.record())
        committer.fail(spec.record(), number, f"Traceback\n  much\nValueError: kind {index % 8}")
    assert len(shown(tmp_path).splitlines()) < 25


def test_history_holds_attempts_messages_and_the_traceback(one_failed: Path) -> None:
    done, failed = sorted(Results.open(one_failed).runs(), key=lambda manifest: manifest.status)
    text = printed(partial(progress.show_history, failed.run.run_id[:-3], one_failed))
    assert "attempt 0: failed" in text
    assert "FileNotFoundError" in text
    assert "in sample" in text, "the traceback names the function"
    text = printed(partial(progress.show_history, done.run.run_id, one_failed))
    assert f"from step 0 of {SCHEDULE.steps:,}" in text
    assert "checkpoint of" in text
    assert text.rstrip().endswith("done")
    with pytest.raises(ValueError, match="unknown run 'other'"):
        progress.show_history("other", one_failed)


def test_a_plan_again_holds_what_failed_or_is_named(one_failed: Path) -> None:
    done, failed = sorted(Results.open(one_failed).runs(), key=lambda manifest: manifest.status)
    by_name = rerun_plan(str(one_failed), [failed.run.run_id[:-2]], failed=False)
    for plan in (rerun_plan(str(one_failed), (), failed=True), by_name):
        assert [spec.run_id for spec in plan.runs] == [failed.run.run_id]
    with pytest.raises(ValueError, match="is done"):
        rerun_plan(str(one_failed), [done.run.run_id], failed=False)
    with pytest.raises(ValueError, match="pass run IDs or --failed"):
        rerun_plan(str(one_failed), (), failed=False)


@pytest.mark.usefixtures("cluster")
@pytest.mark.slow
def test_mended_runs_run_again_and_their_cells_are_done(failed_once: Path, one_failed: Path) -> None:
    (failed_once / "needed").touch()
    plan = rerun_plan(str(one_failed), (), failed=True)
    ended = execute_plan(plan, one_failed, settings(teachers=TeacherPlacement.INLINE), None)
    assert (ended.done, ended.failed) == (1, 0)
    assert "campaign short: 2/2 runs done" in shown(one_failed)
    assert sorted(row["outcome"] for row in rows(one_failed, Table.ATTEMPTS)) == ["done", "done", "failed"]
    with pytest.raises(ValueError, match="failed"):
        rerun_plan(str(one_failed), (), failed=True)


@pytest.mark.usefixtures("cluster")
@pytest.mark.slow
def test_a_campaign_that_is_asked_to_stop_leaves_checkpoints_and_goes_on_later(tmp_path: Path) -> None:
    what = campaign(lingering(tmp_path))
    asked: list[str] = []

    class Asking:
        """Asks as another machine would, once the run has begun."""

        def update(self, snapshot: Snapshot) -> None:
            if snapshot.running and not asked:
                asked.append(ask_to_stop(Store.open(tmp_path / "root")))

        def close(self, snapshot: Snapshot) -> None: ...

    inline = settings(teachers=TeacherPlacement.INLINE)
    ended = execute_plan(what.plan(), tmp_path / "root", inline, None, Asking())
    (tmp_path / "stopped").touch()
    assert "campaign 'short'" in asked[0]
    assert (ended.done, ended.stopped) == (0, 1)
    assert "No campaign is running" in shown(tmp_path / "root")
    with pytest.raises(NotRunningError):
        ask_to_stop(Store.open(tmp_path / "root"))
    assert execute(what, tmp_path / "root", teachers=TeacherPlacement.INLINE).done == 1


def test_a_watched_status_reads_what_has_changed(one_failed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in one_failed.rglob("*"):
        os.utime(path, (1_000_000_000, 1_000_000_000))
    observer, now = Observer(one_failed), time.time()
    first, read, read_bytes = observer.overview(now), [], Store.read_bytes
    monkeypatch.setattr(Store, "read_bytes", lambda store, path: read.append(path) or read_bytes(store, path))
    assert observer.overview(now) == first
    assert set(read) == {"root.json", "heartbeat.json"}
    read.clear()
    failed = next(run for run in Results.open(one_failed).runs() if run.status is RunStatus.FAILED)
    path = f"manifests/{failed.run.run_id}.json"
    (one_failed / path).write_bytes(replace(failed, error="another").to_bytes())
    read.clear()
    changed = observer.overview(now)
    assert set(read) == {"root.json", "heartbeat.json", path}
    assert changed == overview(one_failed, now) != first
