"""Radar charts: what is drawn where, and what is said to be missing."""

import itertools
import math
import re

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from synthetic_pools import cell, pool

from analysis.charts.paper.style import png
from analysis.comparisons.pairwise import pairwise, pairwise_from_statistics
from analysis.data.reference import paper_frame
from analysis.figures import radar
from analysis.measures.pooling import pooled, reuse_random
from analysis.teacher_styles import teacher_style
from tma_ray.benchmark import STUMP_TRACKS_CHALLENGES

pytestmark = pytest.mark.slow
CHALLENGES = [matrix.challenge for matrix in STUMP_TRACKS_CHALLENGES]
COLUMNS = ["challenge", "teacher", "mastered_percent_mean", "mastered_percent_std", "n"]
Rows = list[tuple[str, str, float, float, int]]


def results(rows: Rows, level: str = "low") -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=COLUMNS)
    return table.assign(environment="stump_tracks", expert_knowledge=level)


def everywhere(teacher: str, mean: float, std: float = 1.0, n: int = 8) -> Rows:
    return [(challenge, teacher, mean, std, n) for challenge in CHALLENGES]


def drawn(table: pd.DataFrame) -> Figure:
    return radar(table, pairwise_from_statistics(table, reference="random"))


def lines_of(figure: Figure, panel: int = 0) -> dict[str, list[float]]:
    lines = [line for line in figure.axes[panel].lines if not str(line.get_label()).startswith("_")]
    return {str(line.get_label()): list(np.asarray(line.get_ydata(), float)[:-1]) for line in lines}


def stars_of(figure: Figure) -> list[Line2D]:
    return [star for star in figure.artists if isinstance(star, Line2D)]


def notes_of(figure: Figure) -> str:
    return re.sub(r"\s+", " ", " | ".join(text.get_text() for text in figure.texts))


def uppers_of(figure: Figure, panel: int = 0) -> list[tuple[float, float]]:
    marks = [line.get_xydata() for line in figure.axes[panel].lines if line.get_gid() == "upper"]
    places = (place for line in marks for place in line)
    return [(round(angle / (2 * math.pi) * len(CHALLENGES)), height) for angle, height in places]


def test_the_papers_numbers_are_ratios_of_its_random() -> None:
    figure = drawn(paper_frame())
    none, low, high = (lines_of(figure, panel) for panel in range(3))
    assert none["alp_gmm"] == pytest.approx([42.8 / 18, 43.7 / 22.2, 42.1 / 27.8, 42.5 / 30.3, 31.5 / 22.3])
    assert low["goal_gan"][2] == pytest.approx(9.3 / 27.8)
    assert high["adr"][3] == pytest.approx(17 / 30.3)
    assert high["random"] == [1.0] * 5
    assert "adr" not in none
    assert "no results of ADR, GoalGAN, Setter-Solver" in notes_of(figure)


def test_the_upper_baseline_is_the_best_on_the_original_space_and_not_for_diverse_students() -> None:
    marks = uppers_of(drawn(paper_frame()), panel=2)
    assert [axis for axis, _ in marks] == [0, 1, 2, 3]
    assert [height for _, height in marks] == pytest.approx([51.9 / 18, 51.9 / 18, 51.9 / 27.8, 51.9 / 30.3])


def test_stars_are_of_those_significantly_better_in_their_colours() -> None:
    rows = [*everywhere("random", 20.0), *everywhere("adr", 40.0), *everywhere("spdl", 5.0)]
    rows += [(c, "riac", 30.0 if c == "mostly_trivial" else 20.5, 1.0, 8) for c in CHALLENGES]
    figure = drawn(results(rows))
    colours = [to_hex(star.get_color()) for star in stars_of(figure)]
    assert colours.count(teacher_style("adr").colour) == 5
    assert colours.count(teacher_style("riac").colour) == 1
    assert teacher_style("spdl").colour not in colours


def test_marks_are_full_where_a_teacher_differs_either_way() -> None:
    rows = [*everywhere("random", 20.0), *everywhere("spdl", 5.0), *everywhere("riac", 20.5)]
    marks = [line for line in drawn(results(rows)).axes[0].lines if len(line.get_xdata()) == 1]

    def fills(teacher: str) -> set[str]:
        mine = [mark for mark in marks if mark.get_marker() == teacher_style(teacher).marker]
        return {to_hex(mark.get_markerfacecolor()) for mark in mine}

    assert fills("spdl") == {teacher_style("spdl").colour}
    assert fills("riac") == {"#ffffff"}


def test_what_is_missing_is_a_gap_and_named() -> None:
    rows = [*everywhere("random", 20.0), *everywhere("adr", 40.0)[:3]]
    figure = drawn(results(rows))
    assert lines_of(figure)["adr"] == pytest.approx([2, 2, 2, math.nan, math.nan], nan_ok=True)
    assert "no results of ADR on rugged difficulty, diverse students" in notes_of(figure)


def test_over_a_random_of_0_results_lie_beyond_the_rings_with_their_stars() -> None:
    rows = [*everywhere("random", 20.0), *everywhere("adr", 40.0), *everywhere("riac", 10.0)]
    rows += everywhere("spdl", 10.0)
    rows = [row for row in rows if row[0] != "mostly_trivial"]
    trivial = {"random": (0.0, 0.0), "adr": (60.0, 1.0), "riac": (30.0, 1.0), "spdl": (0.0, 0.0)}
    rows += [("mostly_trivial", teacher, mean, std, 8) for teacher, (mean, std) in trivial.items()]
    figure = drawn(results(rows))
    lines = lines_of(figure)
    rim = 2.5
    assert rim < lines["riac"][1] < lines["adr"][1]
    assert lines["adr"][:1] == [2]
    assert lines["spdl"][1] == lines["random"][1] == 1
    note = "mostly trivial: Random is at 0, and who is over 0 beyond the rings, best ADR with 60.0"
    assert note in notes_of(figure)
    colours = [to_hex(star.get_color()) for star in stars_of(figure)]
    assert (colours.count(teacher_style("adr").colour), colours.count(teacher_style("riac").colour)) == (5, 1)


def test_stars_of_neighbouring_axes_stay_apart() -> None:
    teachers = [f"teacher_{number}" for number in range(8)]
    rows = [row for name in teachers for row in everywhere(name, 40.0)] + everywhere("random", 20.0)
    table = pd.concat([results(rows, level) for level in ("none", "low", "high")])
    places = np.array([[star.get_xdata()[0], star.get_ydata()[0]] for star in stars_of(drawn(table))])
    assert len(places) == 8 * 5 * 3
    for height in np.unique(places[:, 1].round(3)):
        row = np.sort(places[np.isclose(places[:, 1], height, atol=0.002), 0])
        groups = np.split(row, np.flatnonzero(np.diff(row) > 0.1) + 1)
        assert max(map(len, groups)) <= 4
        assert all(after[0] - before[-1] > 0.2 for before, after in itertools.pairwise(groups))


def test_many_teachers_are_drawn_in_rows_of_panels() -> None:
    teachers = ["random", *(f"teacher_{number}" for number in range(39))]
    figure = drawn(results([row for name in teachers for row in everywhere(name, 20.0)]))
    shown = [sorted(lines_of(figure, panel)) for panel in range(len(figure.axes))]
    assert max(map(len, shown)) <= 9
    assert {name for names in shown for name in names} == set(teachers)


def test_doubtful_results_are_marked_and_explained() -> None:
    figure = drawn(paper_frame())
    marks = [[text for text in axes.texts if text.get_gid() == "doubt"] for axes in figure.axes]
    assert [len(mine) for mine in marks] == [2, 0, 0]  # Random on mostly unfeasible and on mostly trivial
    assert "\N{DAGGER} doubtful result" in notes_of(figure)
    assert "\N{DAGGER}" not in notes_of(drawn(results(everywhere("random", 20.0))))


def test_without_random_there_is_no_ratio_and_of_one_seed_no_star() -> None:
    figure = drawn(results([*everywhere("random", 20.0)[1:], *everywhere("adr", 40.0)]))
    assert lines_of(figure)["adr"] == pytest.approx([math.nan, 2, 2, 2, 2], nan_ok=True)
    assert "no ratio on mostly unfeasible: Random has no result" in notes_of(figure)
    alone = drawn(results(everywhere("adr", 40.0)))
    assert np.isnan(lines_of(alone)["adr"]).all()
    assert not stars_of(alone)
    single = [*everywhere("random", 20.0, math.nan, 1), *everywhere("adr", 40.0, math.nan, 1)]
    figure = drawn(results(single))
    assert lines_of(figure)["adr"] == [2.0] * 5
    assert not stars_of(figure)
    png(figure)


def test_what_cannot_be_drawn_is_refused() -> None:
    table = results([*everywhere("random", 20.0), *everywhere("adr", 40.0)])
    tests = pairwise_from_statistics(table, reference="random")
    with pytest.raises(ValueError, match="expected results with at least one row"):
        radar(table.head(0), tests)
    with pytest.raises(ValueError, match="several of mostly_unfeasible, low, random"):
        radar(pd.concat([table, table.head(1)]), tests)
    with pytest.raises(ValueError, match="teacher not there"):
        radar(table.drop(columns="teacher"), tests)


def test_a_radar_of_our_own_runs_lends_random_to_the_other_levels() -> None:
    cells = [
        cell(teacher, seed, mean + seed, challenge=challenge, expert_knowledge=level)
        for challenge in CHALLENGES
        for teacher, level, mean in (("random", "none", 10), ("adr", "high", 40), ("riac", "none", 10))
        for seed in range(4)
    ]
    runs = reuse_random(pool(*cells))
    figure = radar(pooled(runs), pairwise(runs, "mastered_percent", "random"))
    none, high = lines_of(figure, 0), lines_of(figure, 1)
    assert none == {"random": [1.0] * 5, "riac": [1.0] * 5}
    assert high["adr"] == pytest.approx([41.5 / 11.5] * 5)
    assert [to_hex(star.get_color()) for star in stars_of(figure)] == [teacher_style("adr").colour] * 5
