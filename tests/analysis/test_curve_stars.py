"""Learning curves with stars, against Random, between levels, of Parkour's bodies, and for all pairs."""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from synthetic_curves import MILLION, curve_runs
from synthetic_pools import parkour
from synthetic_results import SyntheticCampaign

from analysis.charts.paper.style import png
from analysis.comparisons.pairwise import pairwise
from analysis.data.columns import COMPARED
from analysis.data.loading import load
from analysis.figures import CurvePanel, body_panels, curves_with_stars, knowledge_panels, pairwise_curves
from analysis.measures.pooling import pool_runs, pooled
from analysis.measures.run_measures import evaluations_at, training_returns_at
from analysis.teacher_styles import teacher_style

pytestmark = pytest.mark.slow
TEACHERS = ("random", "adr", "alp_gmm", "spdl")


@functools.cache
def panel() -> CurvePanel:
    runs = curve_runs(TEACHERS, every=5 * MILLION // 2)
    tests = pairwise(runs, "mastered_percent", "random", [*COMPARED, "step"])
    return CurvePanel("Overall", pooled(runs, by=["step"]), tests)


def stars(axes: Axes) -> dict[str, list[float]]:
    return {str(line.get_gid()): list(line.get_xdata()) for line in axes.lines if line.get_gid()}


def expected(tests: pd.DataFrame, first: str, every: int) -> list[float]:
    due = tests[(tests["first"] == first) & (tests["p"] < 0.05)]
    return [step for step in due["step"] if step and step % every == 0]


def test_stars_stand_at_the_steps_where_a_teacher_differs() -> None:
    shown = panel()
    found = stars(curves_with_stars([shown]).axes[0])
    assert shown.tests is not None
    assert found["above-alp_gmm-low"] == expected(shown.tests, "alp_gmm", 5 * MILLION)
    assert found["below-adr-low"] == expected(shown.tests, "adr", 5 * MILLION)
    assert found["above-alp_gmm-low"][-1] == 20 * MILLION
    assert not any("random" in name for name in found)
    finer = stars(curves_with_stars([shown], every=5 * MILLION // 2).axes[0])
    assert len(finer["above-alp_gmm-low"]) > len(found["above-alp_gmm-low"])


def test_stars_lie_above_the_data_in_the_teachers_colours() -> None:
    figure = curves_with_stars([panel()])
    png(figure)
    axes = figure.axes[0]
    top = axes.get_window_extent().y1
    for line in axes.lines:
        if line.get_gid():
            teacher = str(line.get_gid()).split("-")[1]
            assert to_hex(line.get_color()) == teacher_style(teacher).colour
            assert line.get_window_extent().y0 > top


def test_lines_are_means_with_standard_errors() -> None:
    shown = panel()
    axes = curves_with_stars([shown]).axes[0]
    line = next(line for line in axes.lines if line.get_label() == "ADR")
    rows = shown.curves[shown.curves["teacher"] == "adr"].sort_values("step")
    np.testing.assert_allclose(line.get_ydata(), rows["mastered_percent_mean"])
    band = axes.collections[0].get_paths()[0].vertices
    random = shown.curves[shown.curves["teacher"] == "random"].set_index("step").loc[20 * MILLION]
    error = random["mastered_percent_std"] / np.sqrt(random["n"])
    at_end = band[band[:, 0] == 20 * MILLION, 1]
    assert at_end.max() == pytest.approx(random["mastered_percent_mean"] + error)


def test_case_studies_show_levels_of_a_teacher_by_two_measures_side_by_side() -> None:
    runs = curve_runs(["alp_gmm"], every=5 * MILLION, head_start={"none": 0.0, "low": 0.02, "high": 0.3})
    shown, returns = knowledge_panels(runs)
    assert (shown.measure, returns.measure) == ("mastered_percent", "training_return")
    assert all(panel.tests is None for panel in knowledge_panels(runs, reference=None))
    left, right = curves_with_stars([shown, replace(returns, tests=None)]).axes
    names = ["No expert knowledge", "Low expert knowledge", "High expert knowledge"]
    lines = {str(line.get_label()): line for line in left.lines if line.get_label() in names}
    assert [lines[name].get_linestyle() for name in names] == ["--", "--", "-"]
    assert len({str(line.get_markerfacecolor()) for line in lines.values()}) == 3
    assert {to_hex(line.get_color()) for line in lines.values()} == {teacher_style("alp_gmm").colour}
    assert shown.tests is not None
    assert stars(left)["below-alp_gmm-none"] == expected(shown.tests, "none", 5 * MILLION)
    assert set(stars(left)) == {"below-alp_gmm-none", "below-alp_gmm-low"}
    assert not stars(right)


def parkour_runs() -> pd.DataFrame:
    bodies = ("classic_bipedal", "fish", "climbing_chimpanzee")
    rows = []
    for teacher, means in (("random", (20, 10, 0)), ("alp_gmm", (60, 30, 1))):
        seeds = {body: [mean + seed for seed in range(4)] for body, mean in zip(bodies, means, strict=True)}
        rows += parkour(teacher, seeds, steps=10.0 * MILLION)
    values = [
        {"run_id": row["run_id"], "step": step, "mastered_percent": row["mastered_percent"] * share}
        for row in rows
        for step, share in ((0, 0.0), (5 * MILLION, 0.5), (10 * MILLION, 1.0))
    ]
    cells = pd.DataFrame(rows).drop(columns=["mastered_percent", "step"])
    return pool_runs(cells, pd.DataFrame(values))


def test_parkour_has_a_panel_for_all_bodies_and_one_for_each() -> None:
    panels = body_panels(parkour_runs())
    titles = [panel.title for panel in panels]
    assert titles == ["All bodies", "Classic bipedal", "Climbing chimpanzee", "Fish"]
    assert {int(panel.curves["n"].max()) for panel in panels[1:]} == {4}
    assert panels[0].curves["n"].max() == 12
    figure = curves_with_stars(panels)
    assert stars(figure.axes[1]) == {"above-alp_gmm-low": [5 * MILLION, 10 * MILLION]}
    png(figure)


def test_training_returns_are_the_latest_of_runs_that_got_there(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, grid=2, episode_steps=50_000, evaluation_every=500_000)
    done, half = campaign.run("alp_gmm", 0), campaign.run("alp_gmm", 1, status="running", upto=0.5)
    frames = load(tmp_path)
    steps = [1_000_000, 2_000_000]
    found = training_returns_at(frames, steps).set_index(["step", "run_id"])["training_return"]
    assert set(found.index) == {(1_000_000, done), (1_000_000, half), (2_000_000, done)}
    values = training_returns_at(frames, steps).merge(evaluations_at(frames, steps), on=["step", "run_id"])
    panels = knowledge_panels(pool_runs(frames.cells, values))
    assert panels[1].curves["n"].tolist() == [2, 1]


def test_an_empty_panel_says_so() -> None:
    empty = CurvePanel("Fish", panel().curves.head(0))
    figure = curves_with_stars([panel(), empty, panel()])
    assert [text.get_text() for text in figure.axes[1].texts] == ["no results"]
    assert len(figure.axes) == 3


def test_one_seed_has_neither_band_nor_stars() -> None:
    runs = curve_runs(["random", "adr"], seeds=1, every=5 * MILLION)
    tests = pairwise(runs, "mastered_percent", "random", [*COMPARED, "step"])
    figure = curves_with_stars([CurvePanel("Overall", pooled(runs, by=["step"]), tests)])
    assert not stars(figure.axes[0])
    png(figure)


def of_teachers(*teachers: str) -> pd.DataFrame:
    return panel().curves[panel().curves["teacher"].isin(teachers)]


def with_curves(curves: pd.DataFrame) -> object:
    return curves_with_stars([replace(panel(), curves=curves)])


def several(**changes: object) -> pd.DataFrame:
    first = curve_runs(["adr"], seeds=2, every=5 * MILLION, head_start={"none": 0.0, "high": 0.3})
    return pd.concat([first, curve_runs(["adr"], seeds=2, every=5 * MILLION, **changes)])


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: curves_with_stars([]), "no panels"),
        (lambda: with_curves(of_teachers()), "no panel has results"),
        (lambda: curves_with_stars([panel()], every=7 * MILLION), "none at a multiple of 7,000,000 steps"),
        (lambda: with_curves(pd.concat([panel().curves] * 2)), "several of adr, low, 0"),
        (lambda: with_curves(many(1).drop(columns="step")), "step not there"),
        (lambda: pairwise_curves(of_teachers("adr"), panel().tests), "at least two"),
        (lambda: pairwise_curves(of_teachers(), panel().tests), "at least one row"),
        (lambda: body_panels(several()), "expected one expert_knowledge"),
        (lambda: knowledge_panels(several(mastery_threshold=100.0)), "expected one mastery_threshold"),
    ],
)
def test_what_does_not_fit_is_refused(draw: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        draw()


def test_every_pair_has_a_panel_with_its_two_curves_and_stars() -> None:
    runs = curve_runs(TEACHERS[:3], every=5 * MILLION)
    tests = pairwise(runs, "mastered_percent", None, [*COMPARED, "step"])
    figure = pairwise_curves(pooled(runs, by=["step"]), tests)
    pairs = [
        {str(line.get_label()) for line in axes.lines if not str(line.get_label()).startswith("_")}
        for axes in figure.axes
    ]
    assert pairs == [{"Random", "ADR"}, {"Random", "ALP-GMM"}, {"ADR", "ALP-GMM"}]
    found = {mark.get_gid(): mark.get_offsets()[:, 0].tolist() for mark in figure.axes[2].collections[2:]}
    assert len(pairwise_curves(of_teachers("random", "adr"), panel().tests).axes) == 1
    differ = tests[(tests["first"] == "adr") & (tests["second"] == "alp_gmm") & (tests["p"] < 0.05)]
    assert found == {"alp_gmm-above-adr": differ["step"].tolist()}


def many(count: int) -> pd.DataFrame:
    names = ["random", *(f"teacher_{number:02}" for number in range(count))]
    rows = [(name, "low", step, 4, float(step), 1.0) for name in names for step in (0, 1000)]
    columns = ["teacher", "expert_knowledge", "step", "n", "mastered_percent_mean", "mastered_percent_std"]
    return pd.DataFrame(rows, columns=columns)


def test_curves_of_many_teachers_are_drawn_in_parts_with_random_in_each() -> None:
    figure = curves_with_stars([CurvePanel("Original", many(39))])
    legends = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in figure.axes]
    assert [len(names) for names in legends] == [9, 9, 9, 9, 8]
    assert all("Random" in names for names in legends)
    assert len({name for names in legends for name in names}) == 40


def test_pairs_of_many_teachers_are_a_matrix_of_their_last_differences() -> None:
    tests = pd.DataFrame({"first": ["teacher_00"], "second": ["random"], "step": [1000.0]})
    figure = pairwise_curves(many(39), tests.assign(holm=0.01, difference=3.0))
    axes = figure.axes[0]
    cells, dots = axes.collections[:2]
    assert cells.get_array().shape == (40, 40)
    assert dots.get_offsets().tolist() == [[1, 0], [0, 1]]
    assert len({text.get_text() for text in axes.get_yticklabels()}) == 40
