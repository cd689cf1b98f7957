"""Agreement of budgets: means, correlations and reversed pairs, held against a computation run by run."""

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.charts.base import Curve, Label
from analysis.charts.intervals import budget_chart
from analysis.comparisons.budgets import BUDGETS, BudgetComparison, compare_budgets, effect_correlation
from analysis.data.frames import Frames
from analysis.measures.pooling import runs_after
from analysis.measures.tested import FINAL, HEADLINE


@pytest.fixture(scope="module")
def frames() -> Frames:
    return analysis.load("simulated-1")


@pytest.fixture(scope="module")
def comparison(frames: Frames) -> BudgetComparison:
    runs = runs_after(frames, training=False)
    result = compare_budgets(frames, runs[runs["expert_knowledge"] == "high"])
    assert result is not None
    return result


@pytest.fixture(scope="module")
def curves(frames: Frames) -> Mapping[str, pd.DataFrame]:
    return {str(run_id): rows for run_id, rows in frames.measured.groupby("run_id", observed=True)}


def measured(curve: pd.DataFrame, budget: int) -> tuple[float, float]:
    """Return area and last three of a run up to a budget, from its curve."""
    curve = curve[curve["step"] <= budget]
    steps, mastered = curve["step"].to_numpy(float), curve["mastered_percent"].to_numpy()
    area = np.trapezoid(np.append(mastered[0], mastered), np.append(0, steps)) / budget
    return float(area), float(mastered[-3:].mean())


def test_every_budget_is_that_of_runs_which_end_there(frames, curves, comparison):
    cells = frames.cells[(frames.cells["expert_knowledge"] == "high") & (frames.cells["teacher"] == "riac")]
    for budget in BUDGETS:
        by_challenge = [
            np.mean([measured(curves[run_id], budget) for run_id in runs["run_id"]], axis=0)
            for _, runs in cells.groupby("challenge")
        ]
        area, last_three = np.mean(by_challenge, axis=0)
        assert comparison.means.loc["riac", (HEADLINE, budget)] == pytest.approx(area)
        assert comparison.means.loc["riac", (FINAL, budget)] == pytest.approx(last_three)


def test_agreement_is_that_of_the_runs_of_each_challenge(frames, curves, comparison):
    cells = frames.cells[frames.cells["expert_knowledge"] == "high"]

    def pair(curve: pd.DataFrame) -> tuple[float, float]:
        return measured(curve, BUDGETS[0])[0], measured(curve, BUDGETS[-1])[1]

    spaces = [
        {name: [pair(curves[run]) for run in runs["run_id"]] for name, runs in space.groupby("teacher")}
        for _, space in cells.groupby("challenge")
    ]
    expected, last = effect_correlation(spaces), comparison.agreements[-1]
    assert (last.measure, last.budget) == (FINAL, BUDGETS[-1])
    assert last.correlation.value == pytest.approx(expected.value)
    assert last.correlation.low == pytest.approx(expected.low, abs=1e-6)


def test_pairs_are_reversed_where_the_order_of_their_means_is(comparison: BudgetComparison) -> None:
    for agreement in comparison.agreements:
        early = comparison.means[HEADLINE, BUDGETS[0]]
        later = comparison.means[agreement.measure, agreement.budget]
        pairs = list(itertools.combinations(comparison.means.index, 2))
        signs = [np.sign((early[a] - early[b]) * (later[a] - later[b])) for a, b in pairs]
        assert (agreement.reversed_pairs, agreement.pairs) == (signs.count(-1), len(pairs))
        untied = np.prod([sum(values[a] != values[b] for a, b in pairs) for values in (early, later)])
        assert agreement.tau == pytest.approx(sum(signs) / np.sqrt(untied))


def test_without_a_correlation_the_sentence_has_the_pairs_alone(comparison: BudgetComparison) -> None:
    last = comparison.agreements[-1]
    unknown = replace(last, correlation=effect_correlation([]))
    sentence = replace(comparison, agreements=(unknown,)).sentence()
    assert sentence.endswith(f"20 million, {last.reversed_pairs} of {last.pairs} pairs change places.")
    assert "correlation" not in sentence
    assert "correlation" in comparison.sentence()


def test_runs_of_a_single_budget_are_not_compared() -> None:
    frames = analysis.load("lite-1")
    assert compare_budgets(frames, runs_after(frames, training=False)) is None


def test_lines_of_the_chart_cross_where_pairs_change_places(comparison: BudgetComparison) -> None:
    names = {str(teacher): f"<{teacher}>" for teacher in comparison.means.index}
    chart = budget_chart(comparison, names, "heading")
    panel = chart.all_panels[1]
    lines = {mark.teacher: mark.y for mark in panel.marks if isinstance(mark, Curve)}
    labels = {mark.teacher: (mark.text, mark.y) for mark in panel.marks if isinstance(mark, Label)}
    assert lines.keys() == labels.keys() == names.keys()
    assert all(labels[teacher] == (names[teacher], line[-1]) for teacher, line in lines.items())
    drawn = itertools.combinations(lines.values(), 2)
    crossed = sum((one[0] - other[0]) * (one[-1] - other[-1]) < 0 for one, other in drawn)
    early, last = (comparison.means[FINAL, budget].rank() for budget in (BUDGETS[0], BUDGETS[-1]))
    pairs = itertools.combinations(names, 2)
    assert crossed == sum((early[a] - early[b]) * (last[a] - last[b]) < 0 for a, b in pairs)
