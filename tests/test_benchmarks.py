"""Every benchmark script parses its command line, and runs to its end with its smallest arguments."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "benchmarks"
SHARED = ("campaigns", "pools", "whole_runs")
"""Modules of several scripts."""

SCRIPTS = {path.stem for path in FOLDER.glob("*.py")} - set(SHARED)

GATHERED = set(runpy.run_path(str(FOLDER / "run_all.py"))["SMALLEST"])
"""Scripts that `run_all.py` runs."""

SHORT_RUNS = "--steps 200 --yes --local --teacher-placement inline --results results"

IN_A_MOMENT = "--results results --processes 1 --order 0:1 --minutes 0.2"

STOPPED = "0/1 runs done, 1 stopped"
"""Last line of a run that leaves with a checkpoint when its time is up."""

OTHERS = {
    "claim_standings": "--experiments 1",
    "cohort": "--widths 2 --precisions highest --seconds 0.2 --whole 1 --students ppo --output o.json",
    "data_plane": "--exchanges 5",
    "familywise_error": "--experiments 1",
    "interval_coverage": "--experiments 1",
    "learning": f"{SHORT_RUNS} --seeds 1",
    "lite": IN_A_MOMENT,
    "locomotion": f"{SHORT_RUNS} --seeds 1",
    "pairing": f"{IN_A_MOMENT} --seeds 1",
    "pilot": f"{IN_A_MOMENT} --csv pilot.csv",
    "precision": "--student ppo --seeds 2 --steps 400 --cohort 2 --processes 2 --results results",
    "sac_learning": f"{IN_A_MOMENT} --seeds 1 --parts easy",
    "cluster_scale": "--runs 4",
    "playground": "--episodes 1 --steps 5 --bodies fish",
    "trials": "--trials 20",
    "sensitivity": f"{IN_A_MOMENT} --seeds 1 --parts cohort",
}
"""The other scripts, and the smallest arguments of each."""


def run(place: Path, name: str, *arguments: str) -> str:
    """Return what a script prints, run in `place`."""
    finished = subprocess.run(
        [sys.executable, str(FOLDER / f"{name}.py"), *arguments],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return finished.stdout


def test_every_script_is_run_here() -> None:
    assert GATHERED | set(OTHERS) | {"run_all"} == SCRIPTS


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_the_help_names_the_script(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = str(FOLDER / f"{name}.py")
    monkeypatch.syspath_prepend(str(FOLDER))
    for shared in SHARED:
        monkeypatch.delitem(sys.modules, shared, raising=False)
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(script, run_name="__main__")
    assert ended.value.code == 0
    assert f"usage: {name}.py" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(GATHERED))
def test_a_measurement_ends_and_writes_json(name: str, tmp_path: Path) -> None:
    run(tmp_path, "run_all", "--smallest", "--scripts", name, "--output", "measured")
    assert json.loads((tmp_path / "measured" / f"{name}.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(OTHERS))
def test_another_script_ends_with_its_summary(name: str, tmp_path: Path) -> None:
    summaries = {
        "cluster_scale": "driver_kilobytes_per_run",
        "playground": "fish,stump tracks,1,1,1,1,1,",
        "trials": "rugged_difficulty,1,2.5000,0.0500,5.0000,",
        "claim_standings": "In Parkour ADR is worse than Random.,supported,1 of 1",
        "cohort": "| student | width | alone, µs | players, µs | learner, µs | speed per core |",
        "data_plane": "| Ray calls |",
        "familywise_error": "mastered_area,arcsine,15,",
        "interval_coverage": "bimodal,5,32,",
        "learning": "of 1 seeds walk",
        "lite": STOPPED,
        "locomotion": "climbing_chimpanzee, easy_climbing: mean return by seed",
        "pairing": STOPPED,
        "pilot": STOPPED,
        "precision": "| at 400 steps | highest | medium | difference |",
        "sac_learning": STOPPED,
        "sensitivity": STOPPED,
    }
    assert summaries[name] in run(tmp_path, name, *OTHERS[name].split())
    assert summaries[name] != STOPPED or list(tmp_path.glob("results/checkpoints/*/*/index.json"))
