"""Cells of trials against lite-2: the cheapest set that decides about as often as all cells."""

import pandas as pd
import pytest

from analysis.baselines import find_baseline

trial_cells = pytest.importorskip("trial_cells")
HOURS, DECIDED = "core-hours of a trial", "decided against Random, %"


def table(*rows: tuple[str, float, float]) -> pd.DataFrame:
    """Sets of cells with the core-hours and the decided percentage of a trial, after two single cells."""
    return pd.DataFrame([("a", None, None), ("b", None, None), *rows], columns=["cells", HOURS, DECIDED])


@pytest.mark.parametrize(
    ("fewer", "cells"),
    [
        (("a", 7.9, 95.1), ["a"]),
        (("a", 8.1, 99.0), ["a", "b"]),
        (("a", 1.0, 94.9), ["a", "b"]),
    ],
    ids=["cheaper", "saves under a fifth", "decides less"],
)
def test_the_cheapest_set_that_decides_as_often_is_recommended(fewer, cells):
    assert trial_cells.recommended(table(fewer, ("a; b", 10.0, 96.0))) == cells


def test_of_several_such_sets_the_cheapest_is_recommended() -> None:
    rows = table(("a", 2.0, 95.5), ("a; c", 1.5, 96.5), ("a; b; c", 10.0, 96.0))
    assert trial_cells.recommended(rows) == ["a", "c"]


def test_cells_of_fewer_steps_cost_less_and_are_those_of_possible_trials() -> None:
    """Students forget at shares of their budget, so that runs of fewer steps differ from the beginning."""
    baseline = find_baseline("lite-1")
    whole, half = ({cell.name: cell for cell in trial_cells.released(baseline, at)} for at in (None, 10**6))
    assert set(whole) - set(half) == {"forgetting_student"}
    for name, cell in half.items():
        assert cell.hours == pytest.approx(whole[name].hours / 2)
    early, late = (cells["original"].samples["random"] for cells in (half, whole))
    assert early.size == late.size
    assert 0 < early.mean() < late.mean()


def test_trials_against_lite_2_have_the_recommended_cells() -> None:
    measured = pd.read_csv(trial_cells.PILOT.with_name("trial_cells.csv"))
    assert sorted(find_baseline("lite-2").manifest.trial_cells) == trial_cells.recommended(measured)
