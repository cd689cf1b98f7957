"""What takes over an hour says its cost and is confirmed first; what is done does not count."""

import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tma_ray.campaign import Campaign, cells_of, costs
from tma_ray.campaign.cluster.nodes import autoscaled_nodes
from tma_ray.campaign.costs import Throughput, estimate, long_cost
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.script import confirm
from tma_ray.campaign.settings import GIB, ExecutionConfig, Nodes
from tma_ray.cli import main
from tma_ray.results import Committer, RunWriter
from tma_ray.runs import Schedule

ROOT = Path(__file__).parents[2]
MEASURED = Throughput("measured", 1_000, 50_000, 100)
NODE = {"CPU": 16.0, "memory": 26.0 * GIB}


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stands for a measurement of seconds."""
    monkeypatch.setattr(costs, "known_speeds", lambda kinds, *_: dict.fromkeys(kinds, MEASURED))
    watched_by(monkeypatch, person=False)


def watched_by(monkeypatch: pytest.MonkeyPatch, *, person: bool) -> None:
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: person)


def plan_of(student: str, steps: int, seeds: int = 2) -> Plan:
    schedule = Schedule(steps=steps)
    return Campaign("planned", cells_of(("random",), (student,)), tuple(range(seeds)), schedule).plan()


def test_without_a_budget_it_is_refused_with_cost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "root"
    assert main(["campaign", "--teachers", "random,alp_gmm", "--results", str(root)]) == 2
    refusal = capsys.readouterr().err
    assert "core-hours" in refusal
    assert "pass --yes" in refusal
    assert main(["run", "--results", str(root)]) == 2
    assert "pass --yes" in capsys.readouterr().err
    assert main(["campaign", "--dry-run", "--results", str(root)]) == 0
    assert "cost: " in capsys.readouterr().out
    assert not root.exists()


def test_a_campaign_on_a_cluster_is_refused_at_once_with_the_clusters_cost(tmp_path, capsys, monkeypatch):
    """Also at a terminal: that of ``ray submit --tmux`` is watched by nobody."""
    monkeypatch.setattr("builtins.input", lambda _: pytest.fail("nobody can answer"))
    watched_by(monkeypatch, person=True)
    nodes = Nodes((NODE, NODE), "on the cluster's 2 nodes")
    monkeypatch.setattr("tma_ray.campaign.cluster.nodes.cluster_nodes", lambda *_, **__: nodes)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        for command in (["campaign"], ["experiment", "parkour"]):
            assert main([*command, "--address", address, "--results", str(tmp_path / "root")]) == 2
            refusal = capsys.readouterr().err
            assert "runs at once on the cluster's 2 nodes" in refusal
            assert "pass --yes" in refusal


def test_a_cluster_may_grow_to_the_nodes_of_its_file() -> None:
    """Read from the autoscaler's command line: cluster.yaml has 20 nodes without GPUs and 4 with one."""
    flags = ("--gcs-address=10.1.2.3:6379", f"--autoscaling-config={ROOT / 'cluster.yaml'}")
    command = [sys.executable, "-c", "print(flush=True); input()", *flags]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as monitor:
        monitor.stdout.readline()
        try:
            without = autoscaled_nodes(["10.1.2.3:6379"], gpus=False)
            assert Nodes(tuple(without), "").at_once(ExecutionConfig().resources) == 320
            some = [node for node in autoscaled_nodes(["10.1.2.3:6379"], gpus=True) if node.get("GPU")]
            assert len(some) == 4
            assert autoscaled_nodes(["10.9.9.9:6379"], gpus=False) == []
        finally:
            monitor.kill()


def test_the_time_on_a_cluster_is_that_of_all_its_nodes() -> None:
    plan, nodes = plan_of("sac", 20_000_000, seeds=64), Nodes((NODE, NODE), "on the cluster's 2 nodes")
    here, there = (long_cost(plan, "nowhere", ExecutionConfig(), nodes=each) for each in (None, nodes))
    assert there.hours == here.hours
    assert there.wall_hours == pytest.approx(there.hours / 32)
    shared = ExecutionConfig(device="cuda")
    gpus = Nodes(({**NODE, "GPU": 2.0}, {**NODE, "GPU": 1.0}, NODE), "on the cluster's 3 nodes")
    speed = replace(MEASURED, learner=1e5)
    found = lambda kinds, *_: dict.fromkeys(kinds, speed)  # noqa: E731
    cost = estimate(plan_of("ppo", 20_000_000, seeds=144), shared, None, found, gpus)
    assert "3 cohorts of 48 runs on 3 GPUs and 48 cores on the cluster's 3 nodes" in cost.summary()
    cost = estimate(plan_of("ppo", 20_000_000, seeds=60), shared, None, found, gpus)
    assert "2 cohorts" in cost.summary(), "no run is left for a third"


def test_only_what_takes_over_an_hour_has_to_be_confirmed(tmp_path: Path) -> None:
    assert long_cost(plan_of("ppo", 1_000_000), str(tmp_path), ExecutionConfig()) is None
    assert long_cost(plan_of("sac", 100_000), str(tmp_path), ExecutionConfig()) is None
    cost = long_cost(plan_of("sac", 20_000_000), str(tmp_path), ExecutionConfig())
    per_run = 20_000_000 / next(iter(cost.throughputs.values())).training / 3600
    assert cost.hours == pytest.approx(2 * per_run, rel=0.05)


def test_runs_that_are_done_do_not_count(tmp_path: Path) -> None:
    plan = plan_of("sac", 20_000_000)
    whole = long_cost(plan, str(tmp_path), ExecutionConfig())
    committer = Committer.open(tmp_path)
    for done, left in enumerate((whole.hours / 2, 0.0), start=1):
        record = plan.runs[done - 1].record()
        attempt = committer.start(record)
        committer.finish(record, attempt, RunWriter(committer.store, record.run_id, attempt).finish())
        cost = long_cost(plan, str(tmp_path), ExecutionConfig())
        assert (cost.hours if cost else 0.0) == pytest.approx(left)


def test_the_answer_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    cost = long_cost(plan_of("sac", 20_000_000), "nowhere", ExecutionConfig())
    assert cost is not None
    confirm("campaign 'x'", cost, yes=True)
    with pytest.raises(ValueError, match="pass --yes"):
        confirm("campaign 'x'", cost, yes=False)
    watched_by(monkeypatch, person=True)
    asked: list[str] = []
    answers = iter(("y", "", "n", "what?"))
    monkeypatch.setattr("builtins.input", lambda question: asked.append(question) or next(answers))
    confirm("campaign 'x'", cost, yes=False)
    assert "core-hours" in asked[0]
    for _ in range(3):
        with pytest.raises(ValueError, match="not started"):
            confirm("campaign 'x'", cost, yes=False)
