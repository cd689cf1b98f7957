"""A folder with what pages assume to be there."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from blocks import ROOT
from commands import TINY

from tma_ray.campaign.costs import estimation
from tma_ray.campaign.costs.speed import Throughput
from tma_ray.cli import main

RELEASE_FOLDERS = ROOT / "tests" / "importing" / "release_folders.py"
"""Writes folders in the format of the original release's results."""

LINKED = ("experiments", "docs", "cluster.yaml")
"""What of the repository the commands of pages name."""


@pytest.fixture(scope="session")
def documented(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results root with two teachers' runs."""
    folder = tmp_path_factory.mktemp("documentation")
    (folder / "one.csv").write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n")
    small = [*TINY[:-1], str(folder / "one.csv"), "--probe-interval", "100", "--training-window", "100"]
    for teacher in ("random", "alp_gmm"):
        for seed in "01":
            run = ["run", "--teacher", teacher, "--student", "ppo", "--seed", seed, *small]
            assert main([*run, "--results", str(folder / "results")]) == 0
    _original(folder / "original")
    return folder


def _original(folder: Path) -> None:
    """Writes somebody's copy of the original release: a run, a test set, and a network's weights."""
    spec = importlib.util.spec_from_file_location("release_folders", RELEASE_FOLDERS)
    assert spec is not None and spec.loader is not None  # noqa: PT018
    module = importlib.util.module_from_spec(spec)
    sys.modules["release_folders"] = module  # dataclasses look for their module there
    spec.loader.exec_module(module)
    module.Release(folder / "results").sac(module.stumps("Random", 1))
    (folder / "test_sets").mkdir()
    (folder / "test_sets" / "stumps.csv").write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n")
    shapes = {"w1": (4, 64), "w2": (64, 64), "w3": (64, 64), "w4": (64, 64), "w5": (64, 2)}
    np.savez(folder / "cppn.npz", **{name: np.zeros(shape, np.float32) for name, shape in shapes.items()})


@pytest.fixture
def place(documented: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what pages assume: results, a test set, the examples, and the checkout's files."""
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
    monkeypatch.setattr(
        estimation,
        "measured_speeds",
        lambda kinds, *_: dict.fromkeys(kinds, Throughput("any", 1e4, 1e4, 100)),
    )
    return tmp_path
