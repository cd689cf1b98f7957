"""The executor of Ray actors with actors that are threads: endings, losses, room."""

import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for_futures
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ray.exceptions import ActorDiedError, RayTaskError
from small_runs import rows
from test_campaign import campaign, idle, lingering, quiet, settings

from tma_ray.campaign.executors import actors, ray_executor
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.failures import HeadLostError
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import TeacherPlacement
from tma_ray.results import Committer, Results, RunStatus, Table
from tma_ray.runs import RunSpec

pytestmark = pytest.mark.usefixtures("threads")
NODE = {"NodeID": "here", "Resources": {"CPU": 2.0, "memory": 8 * 2**30}}


class Call:
    """A method of an actor: an error becomes one of Ray's, as it does on the way to the driver."""

    def __init__(self, pool: ThreadPoolExecutor, method: Callable[[], Any]) -> None:
        self._pool, self._method = pool, method

    def remote(self) -> Future[Any]:
        return self._pool.submit(self._run)

    def _run(self) -> Any:
        try:
            return self._method()
        except ActorDiedError:
            raise
        except Exception as error:
            text = traceback.format_exc()
            raise RayTaskError("run", text, error, pid=1, ip="127.0.0.1").as_instanceof_cause() from error


class Head:
    """A head that is lost after so many looks."""

    def __init__(self, looks: float = float("inf")) -> None:
        self._looks = looks

    def nodes(self) -> list[dict[str, Any]]:
        return [NODE]

    def check(self) -> None:
        self._looks -= 1
        if self._looks < 0:
            raise HeadLostError("the head is gone")


@pytest.fixture
def dying() -> list[str]:
    """Run whose first actor dies, by id."""
    return []


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch, dying: list[str]) -> Iterator[None]:
    with ThreadPoolExecutor(16) as pool:

        def launch(_resources: Any, _strategy: Any, *arguments: Any) -> Any:
            actor = actors.SeedActor(*arguments)
            run_id = RunSpec.from_dict(arguments[0]).run_id

            def run() -> Any:
                if run_id in dying:
                    dying.remove(run_id)
                    raise ActorDiedError()
                return actor.run()

            methods = {"run": run, "report": actor.report, "request_stop": actor.request_stop}
            return SimpleNamespace(**{name: Call(pool, method) for name, method in methods.items()})

        def wait(calls: Sequence[Any], num_returns: int = 1, timeout: float | None = None) -> Any:
            done = wait_for_futures(calls, timeout, FIRST_COMPLETED).done
            ready = [call for call in calls if call in done][:num_returns]
            return ready, [call for call in calls if call not in ready]

        node = SimpleNamespace(get_node_id=lambda: "here")
        calls = {"wait": wait, "get": lambda call, timeout=None: call.result(timeout)}
        ray = SimpleNamespace(kill=lambda actor: None, get_runtime_context=lambda: node, **calls)
        for module in (actors, ray_executor):
            monkeypatch.setattr(module, "ray", ray)
        monkeypatch.setattr(actors.SeedActor, "launch", launch)
        monkeypatch.setattr(actors, "skip_pandas", lambda: None)
        monkeypatch.setattr("tma_ray.results.storage.base.FIRST_PAUSE", 0.01)
        yield


def scheduler(root: Path, head: Head | None = None, **changes: Any) -> Scheduler:
    chosen = settings(teachers=TeacherPlacement.INLINE, poll_seconds=0.05, **changes)
    committer, seen = Committer.open(root), head or Head()
    executor = RayExecutor(committer.store, chosen, seen)
    return Scheduler(committer, executor, chosen, quiet())


def outcomes(root: Path) -> list[str]:
    return sorted(row["outcome"] for row in rows(root, Table.ATTEMPTS))


def test_a_run_that_raises_fails_and_the_others_go_on(tmp_path: Path) -> None:
    runs = campaign(idle("misbehaving:Raising"), idle("random")).plan().runs
    ended = scheduler(tmp_path).execute(runs, lambda: False)
    assert (ended.done, ended.failed, ended.waiting) == (1, 1, 0)
    assert not list(tmp_path.glob("checkpoints/*/*")), "they go when a run has ended"
    (failed,) = [run for run in Results.open(tmp_path).runs() if run.status is RunStatus.FAILED]
    assert "a teacher's own mistake" in str(failed.error)


def test_a_lost_run_is_repeated_until_it_was_lost_too_often(tmp_path: Path, dying: list[str]) -> None:
    (spec,) = campaign(idle("random")).plan().runs
    dying.append(spec.run_id)
    assert scheduler(tmp_path / "once").execute([spec], lambda: False).done == 1
    assert outcomes(tmp_path / "once") == ["done", "lost"]
    dying += 3 * [spec.run_id]
    ended = scheduler(tmp_path / "often", most_losses=2).execute([spec], lambda: False)
    assert (ended.done, ended.failed) == (0, 1)
    (failed,) = Results.open(tmp_path / "often").runs()
    assert "it was lost 3 times" in str(failed.error)


def test_a_lost_head_ends_the_campaign_and_its_runs_are_recorded_as_lost(tmp_path: Path) -> None:
    (spec,) = campaign(lingering(tmp_path)).plan().runs
    with pytest.raises(HeadLostError):
        scheduler(tmp_path / "root", Head(looks=3)).execute([spec], lambda: False)
    (tmp_path / "stopped").touch()
    assert outcomes(tmp_path / "root") == ["lost"]


def test_an_executor_takes_as_many_runs_as_nodes_hold(tmp_path: Path) -> None:
    chosen, head = replace(settings(), autoscaling=False), Head()
    executor = RayExecutor(Committer.open(tmp_path).store, chosen, head)
    waiting = deque(campaign(idle("random"), seeds=(0, 1, 2, 3, 4)).plan().runs)
    taken = [executor.take(waiting) for _ in range(5)]
    assert [spec is not None for spec in taken] == [True, True, True, False, False], "one more waits"
