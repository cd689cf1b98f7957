"""Curricula on the task plane, dimension by dimension, and what teachers log."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from synthetic_logs import KINDS, STEPS, axes, curriculum
from views import figure_of, plot_of

from analysis.charts.base import PAGE_WIDTH
from analysis.charts.curricula import (
    BINS,
    MOST_PER_TEACHER,
    QUANTILES,
    hidden_scalars,
    scalar_chart,
    scalars_of,
)
from analysis.charts.page import on_page
from analysis.charts.tasks import ellipse
from analysis.data.curricula import MOST_MOMENTS, PANELS, RETURN_RANGE, RunCurriculum, moments
from analysis.figures import Shot, curriculum_strip, dimension_bands, film_strip
from analysis.names import teacher_order
from analysis.teacher_styles import teacher_style

pytestmark = pytest.mark.slow
PLANE = axes(2)


def film_of(curricula: dict[str, RunCurriculum]) -> Figure:
    teachers = sorted(curricula, key=teacher_order)
    return film_strip([Shot(name, name, curricula[name]) for name in teachers], PLANE, width=PAGE_WIDTH)


def played(world_task: np.ndarray | None = None) -> RunCurriculum:
    steps = np.arange(10, 101, 10)
    tasks = [np.array([s / 50, s / 20], np.float32) for s in steps]
    episodes = pd.DataFrame({"step": steps, "task": tasks, "episodic_return": steps.astype(float)})
    episodes["world_task"] = [world_task] * len(episodes)
    probes = pd.DataFrame({"step": [0, 0, 100], "task": [tasks[0], tasks[1], tasks[9]]})
    updates = pd.DataFrame(columns=["step", "gaussians", "boxes", "scalars"])
    return RunCurriculum(episodes, probes, updates, 100)


def with_update(step: int, **content: object) -> RunCurriculum:
    row = {"step": step, "gaussians": [], "boxes": [], "scalars": []} | content
    return replace(played(), updates=pd.DataFrame([row]))


@pytest.mark.parametrize(
    ("world", "shown"), [(None, [[0.6, 1.5], [0.8, 2.0]]), (np.float32([0.5, 0.25]), [[0.5, 0.25]] * 2)]
)
def test_the_strip_shows_worlds_of_each_part(world: np.ndarray | None, shown: list[list[float]]) -> None:
    panels = curriculum_strip({"adr": played(world)}, PLANE).axes[:PANELS]
    np.testing.assert_allclose(panels[1].collections[0].get_offsets(), shown)


def test_colours_are_the_benchmarks_unless_a_world_has_its_own_threshold() -> None:
    def limits(shown: RunCurriculum) -> tuple[float, float]:
        bar = curriculum_strip({"adr": shown}, PLANE).axes[-1]
        return bar.get_ylim()

    assert limits(played()) == RETURN_RANGE
    percentiles = np.percentile([*range(10, 101, 10), 40], (2, 98))
    assert limits(replace(played(), mastery=40.0)) == pytest.approx(percentiles)
    assert limits(replace(played(), mastery=-500.0))[0] == pytest.approx(-500)


def test_moments_are_spread_over_the_probes_of_all_teachers() -> None:
    late, early = curriculum("random"), curriculum("adr", upto=0.5)
    steps = moments({"random": late, "adr": early})
    assert steps == [0, 4_000_000, 8_000_000, 12_000_000, 16_000_000, 20_000_000]
    assert len(steps) == MOST_MOMENTS
    assert moments({"adr": played()}) == [0, 100]


def test_the_view_shows_probes_at_their_step_and_says_where_there_are_none() -> None:
    late = curriculum("random")
    panels = film_of({"random": late, "adr": curriculum("adr", upto=0.5)}).axes
    random, adr = panels[:MOST_MOMENTS], panels[MOST_MOMENTS : 2 * MOST_MOMENTS]
    np.testing.assert_array_equal(random[2].collections[0].get_offsets(), late.probed_at(8_000_000))
    assert not any(panel.patches for panel in random)
    assert [bool(panel.texts) for panel in adr] == [False] * 3 + [True] * 3


def test_a_moment_between_two_probes_shows_the_earlier_one() -> None:
    shown = curriculum("adr", upto=0.5)
    np.testing.assert_array_equal(shown.probed_at(300_000), shown.probed_at(250_000))
    assert not len(shown.probed_at(STEPS // 2 + 1))


def test_the_latest_update_counts_at_each_moment() -> None:
    box = {"low": [0.0, 0.0], "high": [1.0, 2.0], "score": 0.0}
    before, after = film_of({"adr": with_update(15, boxes=[box])}).axes
    assert not before.patches
    (outline,) = after.patches
    corners = outline.get_xy()
    assert (*corners.min(axis=0), *corners.max(axis=0)) == pytest.approx((0, 0, 1, 2))


def test_an_ellipse_lies_along_its_covariance() -> None:
    # Variances 9 and 1 along axes turned by 30 degrees.
    turn = np.array([[np.cos(np.pi / 6), -np.sin(np.pi / 6)], [np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    edge = np.array(ellipse(np.array([1.0, 2.0]), turn @ np.diag([9.0, 1.0]) @ turn.T)) - [[1.0], [2.0]]
    assert np.ptp(turn.T @ edge, axis=1) == pytest.approx([12, 4])  # two deviations on both sides


def test_heavier_gaussians_are_fuller() -> None:
    parts = [{"weight": w, "mean": [1, 1], "covariance": [[0.1, 0], [0, 0.2]]} for w in (0.1, 0.6, 0.3)]
    drawn = film_of({"alp_gmm": with_update(5, gaussians=parts)}).axes[1].patches
    fill = [patch.get_facecolor()[3] for patch in drawn]
    assert fill == sorted(fill, reverse=True)
    assert fill[0] > 2 * fill[2]


def test_regions_are_coloured_by_score_the_smaller_above() -> None:
    boxes = [
        {"low": [0, 0], "high": [1, 1], "score": 5.0},
        {"low": [0, 0], "high": [3, 4], "score": 0.0},
        {"low": [1, 1], "high": [3, 3], "score": 10.0},
    ]
    figure = film_of({"riac": with_update(5, boxes=boxes)})
    drawn, scale = figure.axes[1].patches, figure.axes[-1]
    assert [np.ptp(patch.get_xy()[:, 0]) for patch in drawn] == [3, 2, 1]
    assert len({patch.get_facecolor() for patch in drawn}) == 3
    assert scale.get_ylabel() == "Score of a region"
    assert scale.get_ylim() == (0, 10)


@pytest.mark.parametrize("teacher", KINDS)
def test_bands_hold_the_quantiles_of_the_probes(teacher: str) -> None:
    shown = curriculum(teacher, 3)
    panels = dimension_bands({teacher: shown}, axes(3)).axes
    for dimension, panel in enumerate(panels):
        levels = np.quantile(shown.probed_at(STEPS)[:, dimension], QUANTILES)
        outer, inner = (band.get_paths()[0].vertices for band in panel.collections[:2])
        for vertices, expected in ((outer, levels[[0, 4]]), (inner, levels[[1, 3]])):
            assert set(np.round(expected, 5)) <= set(np.round(vertices[vertices[:, 0] == STEPS, 1], 5))
        assert panel.lines[0].get_ydata()[-1] == pytest.approx(levels[2])
        assert panel.lines[0].get_color() == teacher_style(teacher).colour


def test_boxes_and_gaussians_are_drawn_dimension_by_dimension() -> None:
    box = {"low": [0, -1, 1], "high": [2, 3, 4], "score": 0.0}
    wide = {"weight": 1.0, "mean": [0, 1, 2], "covariance": np.diag([1.0, 4.0, 9.0]).tolist()}

    def second_panel(**content: object) -> Axes:
        shown = replace(curriculum("adr", 3), updates=with_update(5, **content).updates)
        return dimension_bands({"adr": shown}, axes(3)).axes[1]

    for content, bounds in (({"boxes": [box]}, (-1, 3)), ({"gaussians": [wide]}, (-3, 5))):
        panel = second_panel(**content)
        assert tuple(line.get_ydata()[0] for line in panel.lines[1:]) == bounds
    panel = second_panel(gaussians=[{**wide, "weight": weight} for weight in (0.75, 0.25)])
    sizes = panel.collections[-1].get_sizes()
    assert sizes[0] > sizes[1]


@pytest.mark.parametrize(("size", "rows"), [(1, 1), (6, 5)])
def test_constant_dimensions_are_left_out(size: int, rows: int) -> None:
    panels = dimension_bands({name: curriculum(name, size) for name in ("random", "adr")}, axes(size)).axes
    assert len(panels) == 2 * rows
    names = " ".join(panel.get_ylabel() for panel in panels[::2])
    assert "Dimension 0" in names
    assert "Dimension 3" not in names


def test_scalars_have_a_chart_each_with_every_value_in_its_teachers_colour() -> None:
    shown = {"adr": curriculum("adr", upto=0.5), "spdl": curriculum("spdl")}
    chart = scalar_chart(shown, "log", "caption")
    assert chart is not None
    charts = on_page(chart).plots
    titles = [figure_of(chart).layout.title.text for chart in charts]
    wanted = ["share of space", "alpha", "kl to target"]
    assert all(name in title for name, title in zip(wanted, titles, strict=True))
    assert [chart.teacher for chart in charts] == ["adr", "spdl", "spdl"]
    line = figure_of(charts[2]).data[0]
    np.testing.assert_allclose(line.y, scalars_of(shown["spdl"])["kl_to_target"], rtol=1e-6)
    assert line.line.color == teacher_style("spdl").colour
    assert scalar_chart({"random": curriculum("random")}, "log", "caption") is None


def logged(name: str, values: Sequence[float]) -> RunCurriculum:
    rows = {"step": range(len(values)), "gaussians": None, "boxes": None}
    return replace(played(), updates=pd.DataFrame(rows | {"scalars": [[(name, each)] for each in values]}))


@pytest.mark.parametrize(
    ("values", "ticks"),
    [([7.0, 8.0, 9.0, 8.0], 1), ([2.0, 40.0, 30.0, 3.0], None), ([0.5, 1.0, 2.0, 1.5], None)],
)
def test_numbers_of_components_have_no_ticks_between_them(values: list[float], ticks: int | None) -> None:
    chart = plot_of(scalar_chart({"adr": logged("components", values)}, "log", "caption"))
    assert figure_of(chart).layout.yaxis.dtick == ticks


def test_long_series_are_medians_within_their_range() -> None:
    values = np.random.default_rng(0).normal(size=100 * BINS)
    chart = plot_of(scalar_chart({"adr": logged("loss", values)}, "log", "caption"))
    band, line = figure_of(chart).data
    np.testing.assert_allclose(line.y, np.median(values.reshape(BINS, 100), axis=1), rtol=1e-6)
    assert (max(band.y), min(band.y)) == pytest.approx((values.max(), values.min()))


def test_what_is_not_finite_or_too_much_is_left_out() -> None:
    scalars = [(f"s{i}", float(i)) for i in range(20)] + [("bad", np.nan), ("worse", np.inf)]
    shown = {"adr": with_update(5, scalars=scalars)}
    assert len(scalars_of(shown["adr"])) == 20
    chart = scalar_chart(shown, "log", "caption")
    assert chart is not None
    assert len(chart.all_panels) == MOST_PER_TEACHER
    assert hidden_scalars(shown) == 20 - MOST_PER_TEACHER
