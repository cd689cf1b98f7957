"""The rules of the pilot, on curves whose areas are known."""

import itertools

import numpy as np
import pandas as pd
import pytest

from analysis.baselines import find_baseline
from analysis.comparisons.budgets import effect_correlation
from analysis.formatting import number
from tma_ray.runs import Cell, Schedule, effective_spec
from tma_ray.tasks import KnowledgeLevel

pilot = pytest.importorskip("pilot")
SPIDER = ("diverse_students", "spider")


def line(end: float, student: str = "ppo", teacher: str = "random", seed: int = 1000) -> pd.DataFrame:
    """A run that masters from 0 to `end` percent, in a line; twice as much of half of the tasks."""
    steps = 2_000_000
    step = np.arange(0, steps + 1, 125_000)
    mastered = end * step / steps
    cell = {"challenge": "original", "embodiment": "classic_bipedal", "teacher": teacher, "student": student}
    curve = {"step": step, "mastered_percent": mastered, "mastered_half": 2 * mastered}
    return pd.DataFrame({**cell, "seed": seed, "steps": steps, **curve})


def test_area_and_last_three_of_a_line() -> None:
    (row,) = pilot.areas(pilot.every_second(line(40.0))).itertuples()
    assert (row.area, row.last_three) == pytest.approx((20.0, 35.0))
    (early,) = pilot.areas(line(40.0), until=1_000_000).itertuples()
    assert early.area == pytest.approx(10.0)
    assert pilot.areas(line(40.0).iloc[:-1]).empty  # it is not done


def test_schedules_that_agree_with_all_evaluations_leave_no_residuals() -> None:
    found = pd.concat([line(end, seed=1000 + seed) for seed, end in enumerate((10, 20, 40))])
    *_, every_second, half = pilot.schedule_table(found).splitlines()
    assert "| 1.000 | 0.00 | 3 |" in every_second
    assert "| 2.000 | 0.00 | 3 |" in half


def compared(ends: dict[str, tuple[float, float]], spread: float) -> pd.DataFrame:
    """Run of students under all teachers on all spaces, half of the teachers with each of two ends."""
    runs = [
        line(end + spread * place, student, teacher, 1000 + place).assign(challenge=space, embodiment=body)
        for student, pair in ends.items()
        for space, body in pilot.SPACES
        for teacher, end in zip(pilot.TEACHERS, 2 * pair, strict=True)
        for place in range(4)
    ]
    return pd.concat([*runs, *(line(5, pilot.PAPER, seed=1000 + place) for place in range(4))])


@pytest.mark.parametrize(
    ("ends", "winner"),
    [
        ({"ppo:epochs=6": (20, 30), "ppo:epochs=7": (30, 32)}, "ppo:epochs=6"),  # teachers differ more
        ({"ppo:epochs=6": (20, 30), "ppo:epochs=7": (22, 32)}, "ppo:epochs=7"),  # as much: it learns more
    ],
)
def test_the_student_is_the_one_under_which_teachers_differ(ends, winner):
    found = compared(ends, spread=2)
    assert set(pilot.finalists(found)) == set(ends)
    assert pilot.student_of_choice(found) == winner


def test_a_student_of_half_the_cost_trains_for_twice_the_steps(monkeypatch, tmp_path):
    monkeypatch.setattr(pilot, "MEASURED", tmp_path)
    ratios = {"ppo:epochs=6": 0.55, "ppo:epochs=7": 1.1, "ppo:epochs=8": 0.3}
    costs = pd.DataFrame({"student": ratios.keys(), "ratio": ratios.values()})
    costs.to_csv(tmp_path / "pilot_costs.csv", index=False)
    assert [pilot.steps_of(student) for student in ratios] == [3_750_000, 2_000_000, 4_000_000]
    assert pilot.steps_of(pilot.ROLLOUTS[2]) == pilot.STEPS


def test_runs_of_an_earlier_machine_are_kept_and_not_run_again(monkeypatch, tmp_path):
    csv = tmp_path / "pilot.csv"
    first, second, half = (line(10 * seed, seed=seed) for seed in (1, 2, 3))
    for root, runs in (("one", [first]), ("other", [second, half.iloc[:-1]])):
        monkeypatch.setattr(pilot, "evaluations", lambda _, runs=runs: pd.concat(runs))
        found = pilot.written(root, csv)
    assert {seed for *_, seed in pilot.done(found)} == {1, 2} == set(found["seed"])
    assert len(found) == len(first) + len(second)


def test_runs_under_the_settings_of_a_later_preset_are_not_run_again(monkeypatch, tmp_path):
    before = "ppo:batch_size=500:gamma=0.995:steps_per_update=20000"
    monkeypatch.setattr(pilot, "evaluations", lambda _: line(10, before))
    found = pilot.written("root", tmp_path / "pilot.csv")
    cell = Cell(student="ppo:preset=decisive", expert_knowledge=KnowledgeLevel.HIGH)
    assert pilot.key_of(effective_spec(cell, 1000, Schedule(2_000_000))) in pilot.done(found)


def test_the_note_of_lite_2_has_the_agreement_of_budgets_in_the_pilot() -> None:
    found = pilot.read(pilot.MEASURED / "pilot.csv")
    found = found[found["steps"] == found["steps"].max()]
    early, late = pilot.areas(found, until=2_000_000), pilot.areas(found, until=5_000_000)
    pairs = early.assign(early=early["area"], late=late["last_three"])
    spaces = dict(list(pairs.groupby("challenge")))
    agreement = effect_correlation(
        [
            {name: runs[["early", "late"]] for name, runs in each.groupby("teacher")}
            for each in spaces.values()
        ]
    )
    signs = [
        np.prod(np.sign(first - second))
        for each in spaces.values()
        for first, second in itertools.combinations(
            each.groupby("teacher")[["early", "late"]].mean().to_numpy(), 2
        )
    ]
    note = find_baseline("lite-2").manifest.budget_note
    value, low, high = (number(each, 2) for each in (agreement.value, agreement.low, agreement.high))
    assert f"a pilot of {len(pairs)} runs" in note
    assert f"a correlation of true effects of {value} [{low}, {high}]" in note
    assert f"{signs.count(-1)} of {len(signs)} pairs change places" in note
