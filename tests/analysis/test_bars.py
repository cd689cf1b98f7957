"""Bars with pairs: bars, whiskers, brackets and letters."""

import itertools
import math

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from synthetic_curves import SKILL

from analysis.charts.bars import compact_letter_display, lanes
from analysis.charts.paper.style import png
from analysis.comparisons.pairwise import pairwise_from_statistics
from analysis.figures import Whisker, bars_with_pairs


def results(means: dict[str, float], std: float = 2.0, n: int = 16, **place: str) -> pd.DataFrame:
    table = pd.DataFrame({"teacher": means.keys(), "mastered_percent_mean": means.values()})
    where = {"environment": "stump_tracks", "challenge": "mostly_trivial", "expert_knowledge": "low"}
    return table.assign(mastered_percent_std=std, n=n, **(where | place))


def drawn(table: pd.DataFrame, whisker: Whisker = Whisker.DEVIATION) -> Figure:
    return bars_with_pairs(table, pairwise_from_statistics(table), whisker=whisker)


def brackets(axes: Axes) -> set[str]:
    return {str(line.get_gid()) for line in axes.lines if line.get_gid()}


def letters(axes: Axes) -> dict[int, str]:
    found: dict[int, str] = {}
    for text in sorted(axes.texts, key=lambda text: text.get_position()[0]):
        row = round(text.get_position()[1])
        found[row] = found.get(row, "") + text.get_text()
    return found


def test_bars_show_means_and_whiskers() -> None:
    table = results({"random": 20.0, "adr": 30.0})
    axes = drawn(table).axes[0]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([20, 30])
    assert axes.collections[0].get_segments()[0][:, 0] == pytest.approx([18, 22])
    error = drawn(table, Whisker.ERROR).axes[0]
    assert error.collections[0].get_segments()[0][:, 0] == pytest.approx([19.5, 20.5])


def test_brackets_join_exactly_the_pairs_that_differ() -> None:
    axes = drawn(results({"random": 20.0, "adr": 30.0, "riac": 30.2})).axes[0]
    assert brackets(axes) == {"random differs from adr", "random differs from riac"}
    ends = [max(line.get_xdata()) for line in axes.lines if line.get_gid()]
    assert len(set(ends)) == 2  # two lanes: one spans the other
    assert min(ends) > 32.2  # right of bars and whiskers
    assert max(ends) < axes.get_xlim()[1]


def test_many_pairs_are_letters() -> None:
    means = {teacher: 10.0 * place for place, teacher in enumerate(SKILL)}
    means["spdl"] = means["setter_solver"] + 0.1
    figure = drawn(results(means))
    axes = figure.axes[0]
    assert not brackets(axes)
    shown = letters(axes)
    assert len(shown) == 8
    assert shown[6] == shown[7]  # Setter-Solver and SPDL
    assert len(set(shown.values())) == 7
    assert all(text.get_position()[0] > 62.1 for text in axes.texts)
    table = results(means)
    table.loc[table["teacher"] == "riac", "n"] = 1  # and so never tested
    assert letters(drawn(table).axes[0])[5] == "?"


NAMES = ["a", "b", "c", "d", "e", "f"]


@given(st.sets(st.sampled_from(list(itertools.combinations(NAMES, 2)))))
def test_names_share_a_letter_exactly_if_they_do_not_differ(different: set[tuple[str, str]]) -> None:
    found = compact_letter_display(NAMES, sorted(different))
    assert all(found.values())
    for pair in itertools.combinations(NAMES, 2):
        share = set(found[pair[0]]) & set(found[pair[1]])
        assert bool(share) == (pair not in different)


@given(st.sets(st.tuples(st.integers(0, 7), st.integers(1, 7)).map(lambda s: (s[0], sum(s))), max_size=28))
def test_brackets_of_one_lane_do_not_overlap(spans: set[tuple[int, int]]) -> None:
    for (first, lane), (second, other) in itertools.combinations(lanes(spans).items(), 2):
        assert lane != other or first[1] <= second[0] or second[1] <= first[0]


def test_levels_are_columns_challenges_rows_and_what_is_missing_is_said() -> None:
    low, high = results({"random": 20.0, "adr": 30.0}), results({"random": 20.0}, expert_knowledge="high")
    figure = drawn(pd.concat([low, high, results({"random": 9.0}, challenge="mostly_unfeasible")]))
    unfeasible, empty, trivial, high = figure.axes
    titles = [axes.get_title(loc="left") for axes in figure.axes[:2]]
    assert titles == ["Low expert knowledge", "High expert knowledge"]
    assert unfeasible.get_ylabel() == "Mostly unfeasible"
    assert [bar.get_width() for bar in unfeasible.patches] == [9.0]
    assert [text.get_text() for text in empty.texts] == ["no results"]
    assert [text.get_text() for text in high.texts] == ["\N{EN DASH}"]
    assert len(trivial.patches) == 2


def test_pairs_without_a_test_are_named_and_get_no_mark() -> None:
    table = pd.concat([results({"random": 20.0, "adr": 40.0}), results({"spdl": 30.0}, std=math.nan, n=1)])
    figure = drawn(table)
    assert brackets(figure.axes[0]) == {"random differs from adr"}
    assert "Pairs without a test: ADR and SPDL" in figure.get_supxlabel()
    assert "and 1 more" in figure.get_supxlabel()
    png(figure)


def test_one_teacher_is_one_bar() -> None:
    figure = drawn(results({"a_plug_in_with_a_long_name": 20.0}))
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["a_plug_in_with_a_long…"]
    assert png(figure) == png(drawn(results({"a_plug_in_with_a_long_name": 20.0})))


def test_what_cannot_be_drawn_is_refused() -> None:
    table = results({"random": 20.0, "adr": 30.0})
    tests = pairwise_from_statistics(table)
    with pytest.raises(ValueError, match="at least one row"):
        bars_with_pairs(table.head(0), tests)
    with pytest.raises(ValueError, match="at least one row"):
        bars_with_pairs(table.assign(mastered_percent_mean=math.nan), tests)
    with pytest.raises(ValueError, match="several of mostly_trivial, low, random"):
        bars_with_pairs(pd.concat([table, table.head(1)]), tests)


def test_doubtful_results_are_marked_and_explained() -> None:
    table = results({"random": 20.0, "adr": 30.0})
    marked = drawn(table.assign(doubt=["", "a slip"]))
    marks = [text for text in marked.axes[0].texts if text.get_gid() == "doubt-adr"]
    assert [text.get_text() for text in marks] == ["\N{DAGGER}"]
    assert "\N{DAGGER} A doubtful result" in marked.get_supxlabel()
    assert "\N{DAGGER}" not in drawn(table).get_supxlabel()
