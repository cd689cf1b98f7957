"""Film strips of runs, projections of large task spaces, and animations."""

import io
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Polygon
from matplotlib.text import Text
from PIL import Image
from synthetic_logs import STEPS, axes, curriculum

from analysis.charts.curricula import MOST_FRAMES, MOST_SHOTS, film, sheets
from analysis.charts.paper.drawing import lay_out
from analysis.charts.paper.style import png, styled
from analysis.data.curricula import MOST_MOMENTS, RunCurriculum
from analysis.figures import Shot, animation, film_strip, projected

PLANE = axes(2)


def in_a_corner(log: RunCurriculum) -> RunCurriculum:
    """Return a curriculum with all probed tasks near the lowest corner of the plane."""
    low = np.array([axis.low for axis in PLANE])
    tasks = [np.float32(low + 0.01 * (task - low)) for task in log.probes["task"]]
    return replace(log, probes=log.probes.assign(task=tasks))


def test_rows_are_runs_and_columns_moments() -> None:
    shots = [Shot(f"Seed {seed}", "adr", curriculum("adr")) for seed in (3, 4)]
    figure = film_strip(shots, PLANE, steps=[0, STEPS // 2])
    assert figure.get_figwidth() == 6.9  # a page of a paper
    assert len(figure.axes) == 4
    assert [figure.axes[0].get_ylabel(), figure.axes[2].get_ylabel()] == ["Seed 3", "Seed 4"]
    dots = figure.axes[1].collections[0].get_offsets()
    np.testing.assert_array_equal(dots, shots[0].curriculum.probed_at(STEPS // 2))
    assert isinstance(figure.axes[1].patches[0], Polygon)
    assert len(film_strip(shots, PLANE).axes) == 2 * MOST_MOMENTS


def test_tasks_in_a_corner_are_drawn_at_their_own_scale() -> None:
    """ADR's first tasks are in one corner, and nearly equal; those of another row fill the plane."""
    near = in_a_corner(curriculum("adr"))
    shots = [Shot("near", "adr", near), Shot("far", "random", curriculum("random"))]
    figure = film_strip(shots, PLANE, steps=[0, STEPS])
    first, second, third, _ = figure.axes
    tasks = np.concatenate([shots[0].curriculum.probed_at(step) for step in (0, STEPS)])
    for axis, bounds, values in zip(PLANE, (first.get_xlim(), first.get_ylim()), tasks.T, strict=True):
        assert axis.low <= bounds[0] <= values.min()
        assert values.max() <= bounds[1] < axis.low + 0.1 * (axis.high - axis.low)
    assert second.get_xlim() == first.get_xlim()
    assert third.get_xlim() == (PLANE[0].low, PLANE[0].high)
    assert first.spines["top"].get_edgecolor() != third.spines["top"].get_edgecolor()
    for panel in (first, third):  # both rows have numbers of their own
        assert any(tick.label1.get_visible() for tick in panel.xaxis.get_major_ticks())


@pytest.mark.parametrize("cornered", [False, True], ids=["one scale", "own scales"])
@pytest.mark.parametrize("name", ["Ramp (steps=1000000)", "ACCEL (budget=2000000)"])
def test_titles_of_neighbours_are_a_letter_apart(name: str, cornered: bool) -> None:
    """Near the length at which a title is broken into lines."""
    everywhere = curriculum("random")
    second = in_a_corner(everywhere) if cornered else everywhere
    shots = [Shot(name, "random", each) for each in (everywhere, second) * 2]
    figure, drawn = styled(lay_out)(film(shots, PLANE, 2))
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]
    texts = [(axes.get_title("left"), axes.findobj(Text)) for axes in drawn.values()]
    titles = [next(text for text in found if text.get_text() == title) for title, found in texts]
    letter = 0.6 * titles[0].get_fontsize() * figure.dpi / 72
    boxes = [title.get_window_extent() for title in titles]
    assert all(left.x1 + letter < right.x0 for left, right in itertools.pairwise(boxes))


@pytest.mark.parametrize("count", [0, 1, MOST_SHOTS, MOST_SHOTS + 1, 3 * MOST_SHOTS + 4])
def test_sheets_leave_no_run_out_and_are_of_similar_size(count: int) -> None:
    parts = sheets(range(count))
    assert [run for part in parts for run in part] == [*range(count)]
    sizes = {len(part) for part in parts}
    assert len(parts) == math.ceil(count / MOST_SHOTS)
    assert not sizes or (max(sizes) <= MOST_SHOTS and max(sizes) - min(sizes) <= 1)


def test_a_projection_keeps_two_dimensions_of_tasks_boxes_and_gaussians() -> None:
    whole = {teacher: curriculum(teacher, 6) for teacher in ("adr", "spdl")}
    shown = {teacher: projected(each, (4, 1)) for teacher, each in whole.items()}
    np.testing.assert_array_equal(shown["adr"].probed_at(STEPS), whole["adr"].probed_at(STEPS)[:, [4, 1]])
    np.testing.assert_array_equal(shown["adr"].tasks, whole["adr"].tasks[:, [4, 1]])
    full, flat = (each["spdl"].updates["gaussians"].iloc[-1][0] for each in (whole, shown))
    np.testing.assert_allclose(flat["mean"], np.asarray(full["mean"])[[4, 1]])
    np.testing.assert_allclose(flat["covariance"], np.asarray(full["covariance"])[np.ix_([4, 1], [4, 1])])
    strip = film_strip([Shot(name, name, each) for name, each in shown.items()], PLANE, [STEPS])
    (box,), (gaussian,) = (panel.patches for panel in strip.axes)
    last = whole["adr"].updates["boxes"].iloc[-1][0]
    assert box.get_xy()[0] == pytest.approx((last["low"][4], last["low"][1]))
    corners = gaussian.get_xy()
    assert (corners.min(axis=0) + corners.max(axis=0)) / 2 == pytest.approx(flat["mean"])


def test_of_regions_behind_each_other_the_highest_score_is_seen() -> None:
    shown = projected(curriculum("riac", 6), (0, 1))
    figure = film_strip([Shot("RIAC", "riac", shown)], PLANE, [STEPS])
    scores = sorted(box["score"] for box in shown.updates["boxes"].iloc[-1])
    brightness = [sum(patch.get_facecolor()[:3]) for patch in figure.axes[0].patches]
    assert len(brightness) == len(scores)
    assert brightness == sorted(brightness, reverse=True)  # dark is high, and drawn last


def test_what_cannot_be_drawn_is_refused() -> None:
    six, shots = curriculum("adr", 6), [Shot("ADR", "adr", curriculum("adr"))]
    silent = replace(shots[0].curriculum, probes=shots[0].curriculum.probes.head(0))
    for logs, message in (([six], "have 6 dimensions"), ([], "no runs"), ([silent], "no moments")):
        with pytest.raises(ValueError, match=message):
            film_strip([Shot("ADR", "adr", log) for log in logs], PLANE)
    for dimensions in ((0, 0), (0, 6), (-1, 0)):
        with pytest.raises(ValueError, match="two different ones from 0 to 5"):
            projected(six, dimensions)
    with pytest.raises(ValueError, match=f"1 to {MOST_FRAMES}"):
        animation(shots, PLANE, frames=MOST_FRAMES + 1)
    with pytest.raises(ValueError, match=f"at most {MOST_SHOTS}"):
        animation(shots * (MOST_SHOTS + 1), PLANE)


@pytest.mark.slow
def test_an_animation_moves_is_small_and_repeats_itself() -> None:
    shots = [Shot(name, name, curriculum(name)) for name in ("riac", "alp_gmm")]
    content = animation(shots, PLANE, frames=4, seconds=2)
    assert content == animation(shots, PLANE, frames=4, seconds=2)
    assert len(content) < 200_000
    with Image.open(io.BytesIO(content)) as film:
        assert film.n_frames == 4
        assert film.info["duration"] == 500
        first = np.asarray(film.convert("RGB"))
        film.seek(3)
        last = np.asarray(film.convert("RGB"))
    assert tuple(first[0, 0]) == (255, 255, 255)
    assert (first != last).any()
    assert png(film_strip(shots, PLANE)) == png(film_strip(shots, PLANE))
