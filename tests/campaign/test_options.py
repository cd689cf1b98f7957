import io
import math
import socket
from pathlib import Path

import pytest
from rich.console import Console

from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.options import CampaignOptions, chosen_campaign, parse_seeds
from tma_ray.campaign.progress import ActiveRun, ProgressView, Snapshot
from tma_ray.campaign.script import script
from tma_ray.campaign.settings import ExecutionConfig, Resources, check_address
from tma_ray.cli import main
from tma_ray.console.command_line import read
from tma_ray.physics import engine_in_use
from tma_ray.results import Results, RunStatus
from tma_ray.runs import Status
from tma_ray.support.texts import duration

CAMPAIGN = Campaign("small", cells_of(("random", "alp_gmm"), ("ppo",)), seeds=(0, 1))


def chosen(*arguments: str) -> Campaign:
    return chosen_campaign(CAMPAIGN, options(*arguments))


def options(*arguments: str) -> CampaignOptions:
    return read(script(CAMPAIGN), arguments).keywords.get("options", CampaignOptions())


def test_flags_replace_what_they_name_and_nothing_else() -> None:
    assert chosen() == CAMPAIGN
    teachers = chosen("--teachers", "random,mine:Teacher", "--seeds", "3-5", "--steps", "2M")
    assert [cell.teacher for cell in teachers.cells] == ["random", "mine:Teacher"]
    assert {cell.student for cell in teachers.cells} == {"ppo"}
    assert teachers.seeds == (3, 4, 5)
    assert teachers.schedule.steps == 2_000_000
    assert len(chosen("--students", "ppo,sac", "--expert-knowledge", "none,low,high").cells) == 12
    with pytest.raises(ValueError, match="unknown level of expert knowledge 'medium'"):
        chosen("--expert-knowledge", "medium")


@pytest.mark.parametrize("text", ["", "0", "x", "5-3", "-1", "1,-2", "1.5"])
def test_seeds_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected a number"):
        parse_seeds(text)


def test_a_plan_counts_cells_and_runs() -> None:
    plan = chosen("--expert-knowledge", "none,low", "--steps", "1000").plan()
    assert (len(plan.cell_rows), len(plan.runs), plan.steps) == (8, 4, 4000)
    sizes = "4 cells x 2 seeds = 4 runs (4 more cells share them)"
    assert plan.describe().startswith(f"campaign 'small': {sizes}")


def test_refusals_leave_no_files_and_exit_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "root"
    for command, message in (
        ("run --expert-knowledge hgih", "unknown level of expert knowledge 'hgih'"),
        ("campaign --students pppo", "did you mean 'ppo'"),
    ):
        assert main([*command.split(), "--results", str(root)]) == 2
        assert message in capsys.readouterr().err
    assert not root.exists()
    (tmp_path / "precious.txt").write_text("keep me")
    assert main(["run", "--steps", "10", "--results", str(tmp_path)]) == 2
    assert "precious.txt" in capsys.readouterr().err
    assert main(["status", str(tmp_path)]) == 2


def test_a_run_that_diverges_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is no refusal: it has trained, and its run is marked as failed."""
    corridor = ["run", "--environment", "corridor.py:Corridor", "--embodiment", "", "--steps", "1k"]
    student = "ppo:hidden_units=8x8:steps_per_update=400:batch_size=100:learning_rate=1e30"
    assert main([*corridor, "--student", student, "--results", str(tmp_path / "diverged")]) == 1
    error = capsys.readouterr().err
    assert "failed: ValueError: student 'ppo:" in error
    assert "has diverged by step" in error
    assert "Traceback" not in error
    (failed,) = Results.open(tmp_path / "diverged").runs()
    assert failed.status is RunStatus.FAILED
    raising = ["--student", "ppo", "--teacher", "misbehaving.py:Raising"]
    assert main([*corridor, *raising, "--results", str(tmp_path / "raised")]) == 1
    assert "failed: ZeroDivisionError: a teacher's own mistake" in capsys.readouterr().err


def test_a_campaign_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="0 cells"):
        Campaign("empty", ())
    with pytest.raises(ValueError, match="part of file names"):
        Campaign("../elsewhere", cells_of(("random",)))


def test_the_doctor_says_which_engine_simulates(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert f"{engine_in_use().name}: {engine_in_use().reason}" in shown
    for topic in ("pymunk 7", "usable core", "GPU", "no RAY_ADDRESS", "GiB at"):
        assert topic in shown


def test_resources_decide_how_many_runs_fit() -> None:
    node = {"CPU": 16.0, "GPU": 1.0, "memory": 10 * 2**30}
    assert Resources(cpus=1, memory_gib=1.5).fit_into(node) == 6
    assert Resources(cpus=4, memory_gib=1).fit_into(node) == 4
    assert Resources(gpus=0.5, memory_gib=0).fit_into(node) == 2
    assert Resources(gpus=1).fit_into({"CPU": 4.0, "memory": 2.0**40}) == 0
    with pytest.raises(ValueError, match="cpus = 0"):
        Resources(cpus=0)


def test_a_device_and_a_share_of_a_gpu_belong_together() -> None:
    devices = {"cuda": Resources(gpus=0.25), "cuda:0": Resources(gpus=2), "mps": Resources()}
    for device, resources in devices.items():
        assert ExecutionConfig(resources, device).placement.device == device
    refused = [
        (Resources(gpus=0.5), "cpu", r"each run occupies 0\.5 GPUs: add '--device cuda'"),
        (Resources(gpus=1), "cuda:1", "Ray chooses the GPU"),
        (Resources(), "gpu", "expected one of cpu, cuda"),
    ]
    for resources, device, message in refused:
        with pytest.raises(ValueError, match=message):
            ExecutionConfig(resources, device)
    assert (ExecutionConfig().max_queued, ExecutionConfig(autoscaling=True).max_queued) == (1, 64)
    with pytest.raises(ValueError, match=r"gpus = 1\.5: expected a share of one GPU"):
        Resources(gpus=1.5)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--gpus-per-run", "0.5"], "add '--device cuda'"),
        (["--device", "cuda", "--cohort", "off"], "add '--gpus-per-run 0.25'"),
        (["--device", "cuda", "--gpus-per-run", "1", "--cohort", "4"], "leave out '--gpus-per-run'"),
        (["--cohort", "0"], "expected a number of slots such as 48, or off"),
        (["--address", "http://127.0.0.1:8265"], "ray job submit"),
        (["--address", "ray://127.0.0.1:10001"], "its driver belongs on the cluster"),
        (["--address", "head"], "'host:port'"),
        (["--address", "127.0.0.1:{free}"], "nothing listens there"),
    ],
)
def test_a_campaign_that_cannot_start_says_what_to_change(tmp_path, capsys, flags, message):
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))  # bound, but not listening: nobody can answer there
        flags = [flag.format(free=bound.getsockname()[1]) for flag in flags]
        root = tmp_path / "root"
        assert main(["campaign", "--students", "ppo", "--seeds", "1", "--results", str(root), *flags]) == 2
    assert message in capsys.readouterr().err
    assert not root.exists()


def test_the_address_comes_from_the_environment_and_local_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    def address(*arguments: str) -> str | None:
        return options(*arguments).chosen_address()

    monkeypatch.setenv("RAY_ADDRESS", "10.0.0.5:6379")  # as Ray sets it for a job
    assert address() == "10.0.0.5:6379"
    assert address("--address", "auto") == "auto"
    assert address("--local") is None
    monkeypatch.setenv("RAY_ADDRESS", "")
    assert address() is None


def test_auto_is_the_address_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{listening.getsockname()[1]}")
        check_address("auto")
    with pytest.raises(ConnectionError, match=r"no Ray cluster was joined at '127\.0\.0\.1"):
        check_address("auto")
    monkeypatch.delenv("RAY_ADDRESS")
    check_address("auto")  # Ray looks for one


def test_progress_without_a_terminal_is_plain_lines() -> None:
    text = io.StringIO()
    view = ProgressView(Console(file=text, width=200), line_seconds=0)
    running = [ActiveRun("run", 1000, Status(500, 100.0, 7.0))]
    view.update(Snapshot(3, 1, 0, 0, 1, 1000, 3000, running))
    view.close(Snapshot(3, 2, 1, 0, 0, 0, 3000, []))
    assert text.getvalue().splitlines() == [
        "1/3 runs done, 1 waiting, 1 running, 50% of 3,000 steps, 100 steps/s, about 15 s left",
        "2/3 runs done, 1 failed",
    ]


def test_progress_on_a_terminal_shows_the_runs() -> None:
    text = io.StringIO()
    view = ProgressView(Console(file=text, width=200, force_terminal=True))
    active = [ActiveRun(f"run-{i}", 9, Status(4, 1.0, math.nan)) for i in range(25)]
    view.update(Snapshot(30, 0, 0, 0, 5, 5, 300, active))
    view.close(Snapshot(30, 30, 0, 0, 0, 0, 99, []))
    assert "run-19" in text.getvalue()
    assert "and 5 more running" in text.getvalue()
    assert "run-20" not in text.getvalue()


def test_durations() -> None:
    texts = ["0 s", "59 s", "1 min 0 s", "59 min 59 s", "1 d 1 h"]
    assert [duration(s) for s in (0, 59.9, 60, 3599, 90_000)] == texts
