"""Fixtures: a folder with the files that pages assume."""

import shutil
import sys
import warnings
from pathlib import Path

import pytest
from blocks import ROOT
from commands import TINY

from tma_ray.campaign import costs
from tma_ray.campaign.costs import Throughput
from tma_ray.cli import main

LINKED = ("experiments", "docs", "cluster.yaml")
"""Files and folders of the repository that commands in pages use."""


@pytest.fixture(scope="session")
def documented(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a results root of two teachers."""
    folder = tmp_path_factory.mktemp("documentation")
    (folder / "one.csv").write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n")
    small = [*TINY[:-1], str(folder / "one.csv"), "--probe-interval", "100", "--training-window", "100"]
    for teacher in ("random", "alp_gmm"):
        for seed in "01":
            run = ["run", "--teacher", teacher, "--student", "ppo", "--seed", seed, *small]
            assert main([*run, "--results", str(folder / "results")]) == 0
    return folder


@pytest.fixture
def place(documented: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working directory with the files that pages assume: results, a test set, examples, checkout."""
    shutil.copytree(documented, tmp_path, dirs_exist_ok=True)
    for folder in (tmp_path, tmp_path / "examples"):
        shutil.copytree(ROOT / "examples", folder, dirs_exist_ok=True)
    for name in LINKED:
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "ppo-lite").symlink_to(ROOT / "notebooks" / "data" / "ppo-lite")
    (tmp_path / "examples" / "one.csv").symlink_to(tmp_path / "one.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    speed = Throughput("any", 1e4, 1e4, 100)
    monkeypatch.setattr(costs, "known_speeds", lambda kinds, *_: dict.fromkeys(kinds, speed))
    return tmp_path
