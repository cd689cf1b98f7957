"""What charts show: the numbers of the frames they were made from, at every step."""

import json
import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from views import figure_of, plot_of

from analysis.charts.base import END
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import overview_chart, profile_chart, rank_chart, seeds_chart
from analysis.charts.mastery import SHARES, mastery_chart
from analysis.charts.page import Plot, colour_scale, packed
from analysis.charts.tasks import probed_tasks, training_tasks
from analysis.comparisons.ranks import Rank
from analysis.data.curricula import Axis, RunCurriculum
from analysis.statistics import percent_interval

PLANE = (Axis("Stump height", 0.0, 3.0), Axis("Obstacle spacing (m)", 0.0, 6.0))
CUBE = (Axis("a", 0.0, 1.0), Axis("constant", 2.0, 2.0), Axis("b", -1.0, 1.0), Axis("c", 0.0, 10.0))


def shown(plot: Plot, step: object) -> list[dict[str, Any]]:
    """The traces of a plot at a step, as the page puts them together."""
    figure_of(plot)
    figure = json.loads(plot.json)
    (frame,) = (frame for frame in figure["frames"] if frame["name"] == str(step))
    traces = figure["data"]
    for place, patch in zip(frame["traces"], frame["data"], strict=True):
        traces[place] = traces[place] | patch
    return traces


def points() -> pd.DataFrame:
    rows = [
        {"teacher": teacher, "seed": seed, "step": step, "value": 10.0 * seed + bonus}
        for teacher, bonus in (("random", 0.0), ("alp_gmm", 5.0))
        for seed in (1, 2, 3)
        for step in (0, 100, END)
    ]
    table = pd.DataFrame(rows)
    table.loc[(table["step"] == 0), "value"] = 0.0
    return table


def test_a_curve_has_the_means_and_its_band_one_standard_error() -> None:
    table = pd.DataFrame({"teacher": "random", "step": [0, 5], "n": 4, "mean": [1.0, 3.0]})
    band, line = figure_of(plot_of(learning_curves(table.assign(standard_error=0.5), "Return"))).data
    assert (list(line.x), list(line.y)) == ([0, 5], [1.0, 3.0])
    assert sorted(band.y) == [0.5, 1.5, 2.5, 3.5]
    assert band.meta["teacher"] == line.meta["teacher"] == "random"


def test_seeds_and_their_mean_are_those_of_the_step() -> None:
    chart = plot_of(seeds_chart(points(), "Mastered (%)", "seeds", "title", "caption"))
    for step, dots, mean in ((100, [15.0, 25.0, 35.0], 25.0), (0, [0.0] * 3, 0.0), (END, [15, 25, 35], 25)):
        found = [trace for trace in shown(chart, step) if trace["meta"]["teacher"] == "alp_gmm"]
        assert found[0]["x"] == dots
        assert found[1]["x"] == [mean]


@pytest.mark.parametrize("kind", ["seeds", "overview"])
@pytest.mark.parametrize(("teacher", "values"), [("random", (0.0, 2.0, 30.0)), ("adr", (70.0, 98.0, 100.0))])
def test_intervals_of_percentages_are_in_0_to_100(kind: str, teacher: str, values: tuple[float, ...]) -> None:
    rows = {"teacher": teacher, "seed": [1, 2, 3], "step": END, "value": values, "comparison": "one"}
    table, words = pd.DataFrame(rows), ("title", "caption")
    chart = {
        "seeds": seeds_chart(table, "Mastered (%)", "seeds", *words),
        "overview": overview_chart(table, {"one": "First"}, "Mastered (%)", *words),
    }[kind]
    trace = shown(plot_of(chart), END)[-1]
    (mean,), reach = trace["x"], trace["error_x"]
    margin = 4.302653 * np.std(values, ddof=1) / np.sqrt(3)  # Student's t of 2 degrees of freedom
    ends = mean - reach["arrayminus"][0], mean + reach["array"][0]
    assert ends == pytest.approx(percent_interval(np.mean(values), margin), abs=0.02)
    assert -0.01 < ends[0] < mean < ends[1] < 100.01


def test_an_overview_has_a_trace_for_each_comparison_and_teacher() -> None:
    second = points()[lambda table: table["teacher"] == "random"]
    only = pd.concat([points().assign(comparison="one"), second.assign(comparison="two")])
    rows = {"one": "First", "two": "Second"}
    chart = plot_of(overview_chart(only, rows, "Mastered (%)", "title", "caption"))
    traces = figure_of(chart).data
    pairs = [(trace.meta["comparison"], trace.meta["teacher"]) for trace in traces]
    assert pairs == [("one", "random"), ("one", "alp_gmm"), ("two", "random")]
    assert [trace["x"] for trace in shown(chart, END)] == [[20.0], [25.0], [20.0]]
    assert [round(trace.y[0]) for trace in traces] == [0, 0, 1]
    assert [trace.showlegend for trace in traces] == [True, True, False]


def shares_of(steps: dict[object, list[float]]) -> pd.DataFrame:
    """Shares of seeds that master tasks 0, 1, …, by step."""
    rows = [(step, index, share) for step, shares in steps.items() for index, share in enumerate(shares)]
    return pd.DataFrame(rows, columns=["step", "task_index", "share"]).assign(teacher="adr")


def test_mastered_tasks_are_shares_of_seeds_in_the_order_of_the_tasks() -> None:
    tasks = pd.DataFrame({"task_index": [1, 0], "task": [np.float32([1, 2]), np.float32([0, 5])]})
    chart = plot_of(mastery_chart(shares_of({0: [0.0, 0.5], END: [1.0, 0.5]}), tasks, PLANE))
    (trace,) = figure_of(chart).data
    assert (list(trace.x), list(trace.y)) == ([0, 1], [5, 2])
    assert [shown(chart, step)[0]["marker"]["color"] for step in (0, END)] == [[0, 50], [100, 50]]
    assert chart.teacher == "adr"
    assert "75.0\N{NO-BREAK SPACE}%" in figure_of(chart).layout.title.text


def test_tasks_on_a_full_grid_fill_the_map_at_every_step() -> None:
    places = [(2, 1), (0, 1), (0, 5), (2, 5)]
    tasks = pd.DataFrame({"task_index": range(4), "task": [np.float32(place) for place in places]})
    shares = shares_of({0: [0.0, 0.5, 1.0, 0.25], END: [1.0, 0.5, 0.0, 0.75]})
    chart = plot_of(mastery_chart(shares, tasks, PLANE))
    (trace,) = figure_of(chart).data
    assert trace.type == "heatmap"
    scale = json.loads(chart.json)["data"][0]["colorscale"]  # by a name plotly.js has another one
    assert (scale[0], scale[-1]) == ([0.0, "rgb(247,251,255)"], [1.0, "rgb(8,48,107)"])
    assert (list(trace.x), list(trace.y)) == ([0, 2], [1, 5])
    drawn = [[list(row) for row in shown(chart, step)[0]["z"]] for step in (0, END)]
    assert drawn == [[[50, 0], [100, 25]], [[50, 100], [0, 75]]]


def test_tasks_of_many_dimensions_lie_in_rows_the_easiest_first() -> None:
    tasks = pd.DataFrame({"task_index": range(4), "task": [np.zeros(3, np.float32)] * 4})
    (trace,) = figure_of(plot_of(mastery_chart(shares_of({END: [0, 1, 0.5, 0.2]}), tasks, CUBE))).data
    assert list(zip(trace.x, trace.y, strict=True)) == [(0, -1), (0, 0), (1, 0), (2, 0)]


def curriculum(size: int, gaussians: list[dict[str, Any]], boxes: list[dict[str, Any]]) -> RunCurriculum:
    tasks = [np.full(size, value, np.float32) for value in (0.5, 1.0)]
    episodes = pd.DataFrame({"step": [10, 90], "task": tasks, "episodic_return": [-50.0, 250]})
    episodes["world_task"] = None
    probes = pd.DataFrame({"step": [0, 100], "task": tasks})
    updates = pd.DataFrame({"step": [50], "gaussians": [gaussians], "boxes": [boxes], "scalars": [[]]})
    return RunCurriculum(episodes, probes, updates, steps=100)


def test_a_gaussian_is_outlined_at_two_standard_deviations() -> None:
    covariance = np.array([[0.3, 0.1], [0.1, 0.6]])
    gaussian = {"weight": 1.0, "mean": np.array([1.0, 2.0]), "covariance": covariance}
    chart = plot_of(probed_tasks({"alp_gmm": curriculum(2, [gaussian], [])}, PLANE, "t", "caption"))
    _, outline, dots = shown(chart, 100)
    edge = np.array([outline["x"][:-1], outline["y"][:-1]]).T - [1.0, 2.0]
    distance = np.sqrt(np.einsum("ni,ij,nj->n", edge, np.linalg.inv(covariance), edge))
    assert distance == pytest.approx(2.0, abs=0.01)
    assert (dots["x"], dots["y"]) == ([1.0], [1.0])
    before = shown(chart, 0)
    assert before[1]["x"] == []  # the teacher's first update came later
    assert before[2]["x"] == [0.5]


def test_boxes_of_many_dimensions_span_their_share_of_each_column() -> None:
    box = {"low": np.array([0.25, 2.0, -1.0, 5.0]), "high": np.array([0.5, 2.0, 0.0, 10.0]), "score": 0.0}
    chart = plot_of(probed_tasks({"adr": curriculum(4, [], [box])}, CUBE, "t", "caption"))
    heights = np.array([height for height in shown(chart, 100)[0]["y"] if height is not None]).reshape(3, 5)
    assert heights.min(axis=1) == pytest.approx([0.25, 0.0, 0.5])
    assert heights.max(axis=1) == pytest.approx([0.5, 0.5, 1.0])
    assert len(shown(chart, 100)[2]["x"]) == 3  # one task, a dot for each dimension that varies


def test_training_tasks_are_coloured_by_return_part_by_part() -> None:
    chart = plot_of(training_tasks({"adr": curriculum(2, [], [])}, PLANE, "t", "caption"))
    assert [frame["name"] for frame in chart.frames] == ["20", "100"]  # parts without episodes have none
    assert shown(chart, 20)[0]["marker"]["color"] == [-50.0]
    assert shown(chart, 100)[0]["x"] == [1.0]


def test_a_chart_cannot_end_its_script_element() -> None:
    hostile = "</script><script>alert(1)</script>"
    table = points().replace("alp_gmm", hostile)
    chart = plot_of(seeds_chart(table, "Mastered (%)", "seeds", "title", "caption"))
    assert "<" not in packed(chart.json)
    assert hostile in json.loads(chart.json)["data"][2]["meta"]["teacher"]


def test_tasks_that_more_seeds_master_are_darker() -> None:
    shares, colours = zip(*colour_scale(SHARES.name), strict=True)
    assert (shares[0], shares[-1]) == (0, 1)
    brightness = [sum(map(int, re.findall(r"\d+", colour))) for colour in colours]
    assert brightness == sorted(brightness, reverse=True)


@pytest.mark.parametrize(("runs", "bands"), [(3, 0), (4, 0), (5, 1), (32, 1)])
def test_a_profile_of_few_runs_has_no_band(runs: int, bands: int) -> None:
    table = pd.DataFrame({"threshold": [0, 50], "share": [1.0, 0.4], "low": [0.3, 0.0], "high": [1.0, 0.9]})
    table = table.assign(teacher="adr", n=runs)
    chart = plot_of(profile_chart(table, "Mastered (%)", "profile", "title", "caption"))
    assert sum(trace.fill == "toself" for trace in figure_of(chart).data) == bands
    assert sum(trace.fill != "toself" for trace in figure_of(chart).data) == 1


def test_ranks_are_marks_within_the_ranks_that_tests_leave_open() -> None:
    rest = {"across": {}, "challenges": 3, "mean": 1.0, "low": 0.0, "high": 2.0, "n": 3, "fewest": 3, "of": 3}
    rest |= {"measure": "last_three", "newcomer": False, "chance": 0.5}
    first = Rank("adr", rank=1, better=("spdl",), worse=(), undecided=("random",), left_out=(), **rest)
    last = Rank("spdl", rank=3, better=(), worse=("adr",), undecided=("random",), left_out=(), **rest)
    best, worst = plot_of(rank_chart({"a board": [first, last]})).traces
    assert (best["x"], best["error_x"]["array"], best["error_x"]["arrayminus"]) == ([1.0], [1.0], [0.0])
    assert (worst["x"], worst["error_x"]["array"], worst["error_x"]["arrayminus"]) == ([3.0], [0.0], [1.0])


@pytest.mark.parametrize(("highest", "drawn"), [(10.0, 0), (40.0, 1)])
def test_a_ceiling_is_drawn_unless_it_would_flatten_the_curves(highest: float, drawn: int) -> None:
    table = pd.DataFrame({"teacher": "adr", "step": [0, 5], "n": 4, "mean": [1.0, highest]})
    chart = plot_of(learning_curves(table.assign(standard_error=0.5), "Mastered (%)", ceiling=57.0))
    assert figure_of(chart).layout.yaxis.rangemode == "nonnegative"  # nor does an axis of zeros reach below
    found = [trace for trace in figure_of(chart).data if trace.name == "mastered by any run"]
    assert [list(trace.y) for trace in found] == [[57.0, 57.0]] * drawn
