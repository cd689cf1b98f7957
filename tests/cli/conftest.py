"""Fixtures: a small results root for commands, and known speeds."""

from pathlib import Path

import pytest

from tma_ray.campaign import costs
from tma_ray.campaign.costs import Throughput
from tma_ray.cli import main

TINY = [
    *("--steps", "300", "--evaluation-interval", "300"),
    *("--probe-interval", "100", "--training-window", "100"),
]

MEASURED = Throughput("measured", 1e6, 1e6, 100)
TEACHERS = ("random", "alp_gmm", "alp_gmm:fit_every=20")


@pytest.fixture
def known_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces a measurement of speeds that takes seconds."""
    monkeypatch.setattr(costs, "known_speeds", lambda kinds, *_: dict.fromkeys(kinds, MEASURED))


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results root with runs of two teachers, and of one with another hyper-parameter."""
    folder = tmp_path_factory.mktemp("command_line")
    tests = folder / "one.csv"
    tests.write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n")
    for teacher in TEACHERS:
        run = ["run", "--teacher", teacher, "--student", "ppo:hidden_units=16x16", "--test-set", str(tests)]
        assert main([*run, *TINY, "--results", str(folder / "results")]) == 0
    return folder / "results"
