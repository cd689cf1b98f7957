"""Cores that a process may use: its affinity, and the quotas of its control groups."""

import os
from pathlib import Path

import pytest

from tma_ray.campaign.settings import Resources, this_machine
from tma_ray.cli import main
from tma_ray.runs.placement import usable_cores


def give(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


def limits(groups: str, files: dict[str, str]) -> dict[str, str]:
    """Return the files of control groups, of version 1 or 2."""
    texts = {f"sys/fs/cgroup/{name}": f"{text}\n" for name, text in files.items()}
    return {"proc/self/cgroup": groups, **texts}


DOCKER = "/docker/a\n"


def quota(controller: str, cores: int) -> dict[str, str]:
    values = {"quota": cores * 100_000, "period": 100_000}
    return {f"{controller}/cpu.cfs_{name}_us": str(value) for name, value in values.items()}


def test_are_those_of_the_affinity(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    give(monkeypatch, 3)
    monkeypatch.setattr(os, "cpu_count", lambda: 128)
    assert usable_cores(tmp_path) == 3


def test_are_all_where_there_is_no_affinity(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 10)
    assert usable_cores(tmp_path) == 10


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        (limits("0::/\n", {"cpu.max": "250000 100000"}), 2),
        (limits("0::/\n", {"cpu.max": "20000 100000"}), 1),
        (limits("0::/\n", {"cpu.max": "max 100000"}), 8),
        (limits("0::/\n", {"cpu.max": "1600000 100000"}), 8),
        (limits("0::/jobs/one\n", {"jobs/cpu.max": "300000 100000", "jobs/one/cpu.max": "max 100000"}), 3),
        (limits(f"5:cpuset:{DOCKER}4:cpu,cpuacct:{DOCKER}0::/\n", quota("cpu", 4) | quota("cpuset", 1)), 4),
        (limits("4:cpu:/\n", quota("cpu", 4) | {"cpu/cpu.cfs_quota_us": "-1"}), 8),
    ],
    ids=["v2", "v2 under a core", "v2 without", "v2 above", "v2 around", "v1", "v1 without"],
)
def test_are_within_the_quota_of_the_control_groups(monkeypatch, tmp_path, files, cores):
    give(monkeypatch, 8)
    assert usable_cores(write(tmp_path, files)) == cores


def test_are_what_the_doctor_shows_and_a_plan_counts_on(monkeypatch, capsys):
    give(monkeypatch, 1)
    monkeypatch.setenv("COLUMNS", "500")
    assert main(["doctor"]) == 0
    assert ", 1 usable core, " in capsys.readouterr().out
    assert this_machine().at_once(Resources()) == 1
