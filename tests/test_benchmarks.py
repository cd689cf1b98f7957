"""Every benchmark script parses its command line, and runs to its end with its smallest arguments."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "benchmarks"
SHARED = ("campaigns", "pools", "processes", "seed_statistics", "whole_runs")
"""Modules of several scripts."""

SCRIPTS = {path.stem for path in FOLDER.glob("*.py")} - set(SHARED)

GATHERED = set(runpy.run_path(str(FOLDER / "run_all.py"))["SMALLEST"])
"""Scripts that `run_all.py` runs."""

SHORT_RUNS = "--steps 200 --yes --local --teacher-placement inline --results results"
IN_A_MOMENT = "--results results --processes 1 --order 0:1 --minutes 0.2"

STOPPED = "0/1 runs done, 1 stopped"
"""Last line of a run that leaves with a checkpoint when its time is up."""

OTHERS = {
    "agreement_coverage": ("--experiments 2", "4,5,2,0.95,"),
    "claim_standings": ("--experiments 1", "In Parkour ADR is worse than Random.,supported,1 of 1"),
    "cluster_scale": ("--runs 4", "driver_kilobytes_per_run"),
    "cohort": (
        "--widths 2 --precisions highest --seconds 0.2 --whole 1 --students ppo --output o.json",
        "| student | width | alone, µs | rollout workers, µs | learner, µs | speed per core |",
    ),
    "data_plane": ("--exchanges 5", "| Ray calls |"),
    "familywise_error": ("--experiments 1", "`lite-2`,`mastered_area`,arcsine,22,21,"),
    "interval_coverage": ("--experiments 1", "bimodal,5,32,"),
    "learning": (f"{SHORT_RUNS} --seeds 1", "of 1 seeds walk"),
    "lite": (f"--stage core {IN_A_MOMENT}", STOPPED),
    "locomotion": (f"{SHORT_RUNS} --seeds 1", "climbing_chimpanzee, easy_climbing: mean return by seed"),
    "long_runs": ("--output .", "space,done,needed,core-hours"),
    "pairing": (f"{IN_A_MOMENT} --seeds 1", "/1 runs done"),  # its run may be over by then
    "parkour_pilot": (f"{IN_A_MOMENT} --csv pilot.csv", STOPPED),
    "pilot": (f"{IN_A_MOMENT} --csv pilot.csv", STOPPED),
    "playground": ("--episodes 1 --steps 5 --bodies fish", "fish,stump tracks,1,1,1,1,1,"),
    "precision": (
        "--student ppo --seeds 2 --steps 400 --cohort 2 --processes 2 --results results",
        "| at 400 steps | highest | medium | difference |",
    ),
    "sac_learning": (f"{IN_A_MOMENT} --seeds 1 --parts easy", STOPPED),
    "sensitivity": (f"{IN_A_MOMENT} --seeds 1 --parts cohort", STOPPED),
    "tau_coverage": ("--experiments 1", "10,2,1.00,"),
    "trial_cells": ("--trials 20", "original,10,0.097,1.11,1.25,0.82,,"),
    "trials": ("--trials 20", "rugged_difficulty,1,2.5000,0.0450,5.0000,"),
}
"""The other scripts: the smallest arguments of each, and what its output has."""


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
def test_the_help_names_the_script(name, monkeypatch, capsys):
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
    arguments, summary = OTHERS[name]
    assert summary in run(tmp_path, name, *arguments.split())
    assert summary != STOPPED or list(tmp_path.glob("results/checkpoints/*/*/index.json"))
