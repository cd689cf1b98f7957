"""What commands print fits 80 columns, and names the settings of what ran."""

from __future__ import annotations

from pathlib import Path

import pytest

from tma_ray.cli import main

COMMANDS = [
    "status {root}",
    "status {root} --cells",
    "ranking {root}",
    "claims {root}",
    "claims {root} --details",
    "search {root}",
    "plan stump_tracks_challenges --tier smoke",
    "doctor",
    "list",
    "baselines list",
    pytest.param(
        "simulate --teachers random,alp_gmm:fit_every=20 --challenges original --seeds 1 --episodes 20",
        marks=pytest.mark.slow,
    ),
]


@pytest.mark.usefixtures("known_speeds")
@pytest.mark.parametrize("command", COMMANDS)
def test_tables_fit_80_columns(
    root: Path, command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([word.format(root=root) for word in command.split()]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    sentences = ("cost: ",)  # are never broken, so that they can be searched for
    too_long = [line for line in lines if len(line) > 80 and not line.startswith(sentences)]
    assert not too_long
    assert not any("…" in line for line in lines), "something is cut off"


def test_tables_name_settings(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ranking", str(root)]) == 0
    assert "fit_every=20" in capsys.readouterr().out
    assert main(["status", str(root), "--cells"]) == 0
    assert "alp_gmm:fit_every=20" in "".join(capsys.readouterr().out.split())
