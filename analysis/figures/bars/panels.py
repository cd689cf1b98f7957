"""Panels of `bars_with_pairs`: results, and the pairs of teachers that differ."""

from __future__ import annotations

import functools
import itertools
import string
from dataclasses import dataclass

import numpy as np
import pandas as pd

from analysis.figures.bars.compact_letters import Pair, compact_letter_display
from analysis.figures.elements.checks import significant
from analysis.names import order, title

COLUMNS = 3
"""Panels side by side where there is a single column of them."""


@dataclass(frozen=True, eq=False)
class BarPanel:
    """One panel.

    Attributes:
        titles: of its row and its column of panels.
        rows: by teacher: mean, whisker and doubt; missing where results are.
        different: pairs that differ significantly.
        untested: pairs without a test.
    """

    titles: tuple[str, str]
    rows: pd.DataFrame
    different: list[Pair]
    untested: list[Pair]

    def letters(self) -> dict[str, str]:
        """Returns the letters of each teacher, with a blank for each it has not; "?" of one never tested."""
        names = list(self.rows.index)
        never = [name for name in names if self._never_tested(name)]
        numbers = compact_letter_display([name for name in names if name not in never], self.different)
        count = max((number + 1 for own in numbers.values() for number in own), default=0)
        return dict.fromkeys(never, "?") | {
            name: "".join(string.ascii_letters[number] if number in own else " " for number in range(count))
            for name, own in numbers.items()
        }

    def _never_tested(self, name: str) -> bool:
        return sum(name in pair for pair in self.untested) >= len(self.rows) - 1


def bar_panels(table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str]) -> list[list[BarPanel | None]]:
    """Returns rows of panels, all of one length; None for what is left over of the last row.

    Args:
        table: `by`, teacher, mean, whisker and doubt.
        tests: `by`, first, second and p.
        by: columns that make rows and columns; rows are wrapped if there is a single column.
    """
    rows, columns = (sorted(table[column].unique(), key=functools.partial(order, column)) for column in by)
    panels = [[_panel(table, tests, by, (row, column)) for column in columns] for row in rows]
    if len(columns) > 1:
        return [list(line) for line in panels]
    found: list[BarPanel | None] = [panel for (panel,) in panels]
    found += [None] * (-len(found) % COLUMNS if len(found) > COLUMNS else 0)
    return [found[start : start + COLUMNS] for start in range(0, len(found), COLUMNS)]


def _panel(
    table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]
) -> BarPanel:
    rows = _at(table, by, place).set_index("teacher")[["mean", "whisker", "doubt"]]
    here = _at(tests, by, place)
    here = here[here["first"].isin(rows.index) & here["second"].isin(rows.index)]
    tested = {frozenset(pair) for pair in _pairs(here[here["p"].notna()])}
    untested = [
        pair for pair in itertools.combinations(sorted(rows.index), 2) if frozenset(pair) not in tested
    ]
    titles = title(by[0], place[0]), title(by[1], place[1])
    return BarPanel(titles, rows, _pairs(significant(here)), untested)


def _at(frame: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]) -> pd.DataFrame:
    """Returns the rows of one panel; element by element, since pools are tuples in some tables."""
    here = [values == place for values in frame[list(by)].itertuples(index=False, name=None)]
    return frame[np.array(here, dtype=bool)]


def _pairs(tests: pd.DataFrame) -> list[Pair]:
    return list(tests[["first", "second"]].itertuples(index=False, name=None))
