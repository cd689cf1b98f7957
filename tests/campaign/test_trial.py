"""Trials: which runs a look has, budgets, designs that stay, and an interrupted one that continues."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from analysis.baselines import find_baseline
from analysis.trials.design import make_design
from tma_ray.campaign import trials
from tma_ray.campaign.costs import Cost, Throughput, estimate, speed_key
from tma_ray.campaign.options import TrialOptions
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.repeating import trial_plans
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.cli import main
from tma_ray.results import Results, Store, TrialFile, TrialLook, create_root
from tma_ray.teachers import TEACHERS

Looks = Callable[..., list[int]]
PLACES = [
    ("stump_tracks", "original", "classic_bipedal", "ppo", "high"),
    ("stump_tracks", "diverse_students", "spider", "ppo", "high"),
]


@pytest.fixture(scope="module")
def plans() -> list[Plan]:
    released = Results(find_baseline("lite-1").store())
    return trial_plans("trial", released, "sobol", PLACES, [range(5, 8), range(5, 10)])


def test_a_look_has_its_seeds_of_every_cell_one_cell_after_the_other(plans: list[Plan]) -> None:
    found = [(spec.challenge, spec.seed) for spec in plans[0].runs]
    assert found == [(place[1], seed) for place in PLACES for seed in (5, 6, 7)]
    assert {spec.run_id for spec in plans[0].runs} < {spec.run_id for spec in plans[1].runs}
    assert {spec.schedule.steps for spec in plans[0].runs} == {2_000_000}


def test_a_trial_of_fewer_steps_has_runs_of_these(plans: list[Plan]) -> None:
    released = Results(find_baseline("lite-1").store())
    (shorter,) = trial_plans("trial", released, "sobol", PLACES, [range(5, 8)], 500_000)
    for spec, whole in zip(shorter.runs, plans[0].runs, strict=True):
        assert spec.schedule == replace(whole.schedule, steps=500_000)
        assert replace(spec, schedule=whole.schedule).run_id == whole.run_id


def test_a_cell_whose_runs_depend_on_their_budget_is_refused_at_fewer_steps() -> None:
    released = Results(find_baseline("lite-1").store())
    place = ("stump_tracks", "forgetting_student", "classic_bipedal", "ppo", "high")
    with pytest.raises(
        ValueError, match=r"not the beginning .*forgetting_student: resets: \[700000, 1400000\]"
    ):
        trial_plans("trial", released, "sobol", [place], [range(5, 8)], 1_000_000)


def test_trials_of_two_settings_of_a_teacher_are_two_campaigns() -> None:
    names = [trials.campaign_of(teacher) for teacher in ("accel", "accel:score=mna", "mine:Accel")]
    assert names == ["trial_accel", "trial_accel_score_mna", "trial_mine_accel"]


@pytest.fixture
def cost(plans: list[Plan]) -> Cost:
    """The cost of all looks at 1,000 steps a second."""
    speed = Throughput("ppo", training=1_000, playing=10_000, transition_bytes=0)
    kinds = {speed_key(spec) for plan in plans for spec in plan.runs}
    return estimate(plans[-1], ExecutionConfig(), dict.fromkeys(kinds, speed))


@pytest.fixture
def looks(plans: list[Plan], cost: Cost, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Looks:
    """Run looks, each done at once; return how many runs each had."""

    def run(budget: float | None, ends: list[bool]) -> list[int]:
        asked: list[int] = []

        def executed(plan: Plan, *_: object) -> int:
            asked.append(len(plan.runs))
            return 0

        monkeypatch.setattr(trials, "execute_and_report", executed)
        options = TrialOptions(results=str(tmp_path), local=True, budget=budget)
        judged = iter(ends)
        assert trials.run_looks(trials.TrialRuns(plans, options), cost, lambda: next(judged)) == 0
        return asked

    return run


def test_the_next_look_begins_only_if_the_trial_goes_on(looks: Looks) -> None:
    assert looks(None, [False, False]) == [6, 10]
    assert looks(None, [True]) == [6]


def test_a_look_that_does_not_fit_into_the_budget_does_not_begin(looks, capsys):
    assert looks(0.2, []) == []
    assert "another --budget continues" in capsys.readouterr().out
    assert looks(100.0, [False, False]) == [6, 10]


def test_the_last_look_within_a_budget(plans: list[Plan], cost: Cost, tmp_path: Path) -> None:
    budgets = (None, 0.1, 0.99 * cost.wall_hours, 1.01 * cost.wall_hours)
    options = [TrialOptions(results=str(tmp_path), local=True, budget=budget) for budget in budgets]
    runs = [trials.TrialRuns(plans, each) for each in options]
    assert [trials.affordable_look(each, cost) for each in runs] == [None, 0, 0, 1]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with a trial that has been designed and has no runs."""
    folder = tmp_path_factory.mktemp("trial") / "results"
    baseline = find_baseline("simulated-1")
    design = make_design("sobol", baseline, baseline.frames(), cells=["original"])
    store = Store.open(folder)
    create_root(store)
    TrialFile(design.to_dict(), (TrialLook(3, "look after 3 seeds: open"),)).save(store)
    return folder


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (("sobol", "--margin", "4"), "margin: 2.5, not 4.0"),
        (("riac",), "teacher: 'sobol', not 'riac'"),
        (("sobol", "--cells", "mostly_trivial"), "cells"),
    ],
)
def test_another_design_is_another_trial(planned, changes, named, capsys):
    before = (planned / "trial.json").read_bytes()
    assert main(["trial", *changes, "--simulated", "--results", str(planned)]) == 2
    assert named in capsys.readouterr().err
    assert (planned / "trial.json").read_bytes() == before


def test_the_plan_is_told_before_it_is_spent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "results"
    command = ["trial", "sobol", "--simulated", "--cells", "original", "--dry-run", "--results", str(folder)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "compared with: Random, and CURROT, the best of 16 teachers there" in said
    assert "3, 5, 10, 20 runs, at most 20" in said
    assert not folder.exists()


@pytest.mark.parametrize(
    ("cells", "planned"),
    [
        ([], "3 cells, in this order: forgetting_student, mostly_unfeasible, original"),
        (["--cells", "all"], "7 cells, in this order: forgetting_student"),
        (["--cells", "original"], "1 cell, in this order: original"),
    ],
)
def test_a_trial_has_the_cells_of_its_release_unless_others_are_chosen(cells, planned, tmp_path, capsys):
    command = ["trial", "sobol", *cells, "--dry-run", "--local", "--results", str(tmp_path / "results")]
    assert main([*command, "--against", "lite-2"]) == 0
    said = capsys.readouterr().out
    assert planned in said
    assert ("default cells of trials against lite-2" in said) == (not cells)


def test_a_trial_that_has_begun_keeps_its_steps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baseline = find_baseline("lite-1")
    design = make_design("sobol", baseline, baseline.frames(), cells=["original"], steps=500_000)
    store = Store.open(tmp_path)
    create_root(store)
    released = Results(baseline.store())
    (plan,) = trial_plans("trial_sobol", released, "sobol", design.keys, [design.seeds], 500_000)
    ids = "\n".join(spec.run_id for spec in plan.runs)
    design = replace(design, runs=hashlib.sha256(ids.encode()).hexdigest())
    TrialFile(design.to_dict()).save(store)
    assert main(["trial", "sobol", "--dry-run", "--local", "--results", str(tmp_path)]) == 0
    assert "trial of Sobol against lite-1 after 500 thousand steps" in capsys.readouterr().out


def test_a_trial_that_has_begun_keeps_its_cells(planned: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trial", "sobol", "--simulated", "--dry-run", "--results", str(planned)]) == 0
    assert "1 cell, in this order: original" in capsys.readouterr().out
    every = ["trial", "sobol", "--simulated", "--dry-run", "--cells", "all", "--results", str(planned)]
    assert main(every) == 2
    assert "cells:" in capsys.readouterr().err


def test_a_teacher_whose_limits_are_exceeded_is_refused_before_it_writes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(TEACHERS.get("sobol"), "most_dimensions", 1)
    folder = tmp_path / "results"
    for where in (["--simulated", "--cells", "original"], ["--cells", "original", "--yes", "--local"]):
        assert main(["trial", "sobol", *where, "--results", str(folder)]) == 2
        assert "Sobol teaches in 1 dimensions at most, not 2" in capsys.readouterr().err
        assert not folder.exists()


def test_status_tells_where_a_trial_stands(planned: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(planned)]) == 0
    said = capsys.readouterr().out
    assert "Trial of sobol against simulated-1: under way; looks after 3, 5, 10, 20 seeds" in said
    assert "look after 3 seeds: open" in said
    assert main(["status", str(planned), "--json"]) == 0
    trial = json.loads(capsys.readouterr().out)["trial"]
    assert (trial["design"]["teacher"], trial["ended"]) == ("sobol", "")
    assert trial["looks"] == [{"seeds": 3, "said": "look after 3 seeds: open"}]


@pytest.mark.slow
def test_a_trial_that_is_killed_keeps_its_design_and_comes_to_the_same_verdicts(tmp_path: Path) -> None:
    killed, whole, copied = (tmp_path / name for name in ("killed", "whole", "copied"))
    command = [sys.executable, "-m", "tma_ray", "trial", "sobol", "--simulated", "--cells", "original"]
    started = subprocess.Popen([*command, "--results", str(killed)], start_new_session=True)
    while not list((killed / "manifests").glob("*")):
        assert started.poll() is None
        time.sleep(0.1)
    os.killpg(started.pid, signal.SIGKILL)
    started.wait()
    design = json.loads((killed / "trial.json").read_text())["design"]
    for folder in (killed, whole):
        subprocess.run([*command, "--results", str(folder)], check=True)
    found = [json.loads((folder / "trial.json").read_text()) for folder in (killed, whole)]
    assert found[0] == found[1]
    assert found[0]["design"] == design
    assert found[0]["ended"]
    assert (killed / "trial" / "index.html").exists()
    started_from = [*command, "--results", str(copied), "--start-from", str(whole)]
    done = subprocess.run(started_from, check=True, capture_output=True, text=True)
    assert "runs copied from" in done.stdout
    assert json.loads((copied / "trial.json").read_text()) == found[1]
    assert len(Results.open(copied).runs()) == len(Results.open(whole).runs())
