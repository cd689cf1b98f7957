"""Figures as files: vector and PNG, the same bytes each time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from analysis.charts.paper.style import Vector, save


def figure() -> Figure:
    shown = Figure(figsize=(2, 1))
    shown.subplots().plot([1, 2], label="ALP-GMM ★")
    shown.legend()
    return shown


@pytest.mark.parametrize("vector", Vector)
def test_the_same_figure_gives_the_same_bytes(tmp_path: Path, vector: Vector) -> None:
    first = [file.read_bytes() for file in save(figure(), tmp_path / "one", vector)]
    second = [file.read_bytes() for file in save(figure(), tmp_path / "two", vector)]
    assert first == second
    starts = {Vector.PDF: b"%PDF", Vector.SVG: b"<?xml"}
    assert first[0].startswith(starts[vector])
    assert first[1].startswith(b"\x89PNG")


def test_endings_are_added_and_folders_made(tmp_path: Path) -> None:
    files = save(figure(), tmp_path / "deep" / "after-0.5", Vector.SVG)
    assert files == (tmp_path / "deep" / "after-0.5.svg", tmp_path / "deep" / "after-0.5.png")
    assert all(file.is_file() for file in files)


@pytest.mark.slow
def test_no_file_tells_when_it_was_written(tmp_path: Path) -> None:
    for vector in Vector:
        for file in save(figure(), tmp_path / vector, vector):
            content = file.read_bytes()
            assert b"CreationDate" not in content
            assert b"<dc:date>" not in content
            assert b"tIME" not in content


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_process(tmp_path: Path) -> None:
    code = "import sys, test_saving as t; t.save(t.figure(), sys.argv[1], t.Vector(sys.argv[2]))"
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    for vector in Vector:
        for seed in ("1", "2"):
            environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
            arguments = [sys.executable, "-c", code, str(tmp_path / seed), vector.value]
            subprocess.run(arguments, check=True, env=environment)
        for ending in (vector.value, "png"):
            first, second = ((tmp_path / f"{seed}.{ending}").read_bytes() for seed in "12")
            assert first == second
