"""A report that is watched is written anew when runs have published more."""

from __future__ import annotations

import shutil
from itertools import islice
from pathlib import Path

import pytest

from tma_ray.cli import reporting

ROOT = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"


def test_only_what_runs_publish_counts_as_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(shutil.copytree(ROOT, tmp_path / "root"))
    manifest = next((root / "manifests").iterdir())
    looks: list[float] = []

    def look(seconds: float) -> None:
        looks.append(seconds)
        if len(looks) == 2:
            (root / "report").mkdir()
        if len(looks) % 3 == 0:
            manifest.write_bytes(manifest.read_bytes() + b" ")

    monkeypatch.setattr(reporting.time, "sleep", look)
    list(islice(reporting.changes([str(root), "paper-2021"], 5.0), 2))
    assert looks == [5.0] * 6
