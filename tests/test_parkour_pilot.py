"""The rules of the pilot for the long runs, on curves whose last three evaluations are given."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

pilot = pytest.importorskip("parkour_pilot")
DECISIVE, PAPER = "ppo:preset=decisive", "ppo"


def curves(mastered: Callable[[str, str, str, int, np.ndarray], object]) -> pd.DataFrame:
    """Evaluations of all runs, with the percentage that a function of their cell, seed and steps gives."""
    step = np.arange(0, 6_000_001, 250_000)
    runs = []
    for run in pilot.plan().runs:
        cell = (pilot.canonical_student(run.student), run.embodiment, run.teacher, run.seed)
        row = {"challenge": run.challenge, "embodiment": run.embodiment, "teacher": run.teacher}
        row |= {"student": run.student, "seed": run.seed, "steps": run.schedule.steps}
        runs.append(pd.DataFrame({**row, "step": step, "mastered_percent": mastered(*cell, step)}))
    return pd.concat(runs)


def test_the_plan_has_every_cell_with_both_seeds_once() -> None:
    runs = pilot.plan().runs
    assert len({pilot.key_of(run) for run in runs}) == len(runs) == 16
    assert [run.seed for run in runs] == [1000] * 8 + [1001] * 8
    assert {run.schedule.steps for run in runs} == {6_000_000}
    assert {run.test_set.name for run in runs} == {"parkour_walking", "parkour_swimming"}


def levels(student: str, gap: float, walkers: float) -> Callable[..., object]:
    """Curves at 50 %, at `walkers` for the student's walkers, and `gap` between the student's teachers."""

    def mastered(its: str, body: str, teacher: str, seed: int, step: np.ndarray) -> object:
        level = walkers if its == student and body == "classic_bipedal" else 50
        return level + (gap if its == student else 2) * (teacher == "alp_gmm") + 2 * (seed - 1000) + 0 * step

    return mastered


@pytest.mark.parametrize("student", [DECISIVE, PAPER])
def test_the_student_is_the_one_under_which_teachers_differ(student: str) -> None:
    name = pilot.canonical_student(student)
    assert pilot.chosen_student(curves(levels(name, 20, 40))) == student


@pytest.mark.parametrize("student", [DECISIVE, PAPER])
def test_a_student_whose_walkers_master_under_half_is_not_chosen(student: str) -> None:
    name = pilot.canonical_student(student)
    (other,) = {DECISIVE, PAPER} - {student}
    assert pilot.chosen_student(curves(levels(name, 20, 10))) == other


def test_tables_show_what_is_done_so_far() -> None:
    evaluations = curves(levels(DECISIVE, 20, 40))
    first = evaluations[(evaluations["embodiment"] == "fish") & (evaluations["seed"] == 1000)]
    table = pilot.tables(first)
    assert "| classic_bipedal |" not in table
    assert f"| `{DECISIVE}` | 6 | nan | 60.0 |" in table


def test_without_any_signal_the_student_of_lite_2_and_6_million_steps() -> None:
    flat = curves(lambda _student, _body, _teacher, seed, step: 10.0 * (seed - 999) + 0 * step)
    assert pilot.chosen_student(flat) == DECISIVE
    assert pilot.chosen_budget(flat, DECISIVE) == 6


@pytest.mark.parametrize(("onset", "budget"), [(1, 4), (4.2, 5), (5.2, 6)])
def test_the_budget_is_the_smallest_that_decides(onset: float, budget: int) -> None:
    def mastered(_student: str, _body: str, teacher: str, seed: int, step: np.ndarray) -> object:
        return 30 + 4 * (seed - 1000) + 20 * ((teacher == "alp_gmm") & (step >= onset * 1e6))

    evaluations = curves(mastered)
    assert pilot.chosen_budget(evaluations, DECISIVE) == budget
    assert f"| `{DECISIVE}` | 6 |" in pilot.tables(evaluations)
