"""The vocabulary of charts: marks in panels, computed once, which `charts.paper` and `charts.page` draw.

A module of this room computes the `Chart` of one kind of figure from tables. A renderer knows marks and
panels, and no kind of figure: a new figure of these marks is one file, on paper and on pages.

Functions that return charts have arguments in common: `name` is the identifier on a page, `heading` the
title, `caption` the content and number of runs, and `quantity` the title of the axis of values.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.looks import INK, Look
from analysis.statistics import SIGNIFICANCE

END = "end"
"""Moment of a panel that shows the ends of runs; other moments are steps."""

ONE_COLUMN, TWO_COLUMNS, PAGE_WIDTH = 3.3, 6.9, 10.2
"""Widths of a figure: a column and both columns of a paper, and a page on the screen, in inches."""

LEAST_PERCENT = 5.0
"""Axes of mastered % reach at least this far, so that one task of a hundred never looks like a triumph."""

TOGETHER = 8
"""Number of teachers beside Random in one panel; more of them are drawn in several panels."""

LONGEST_NAME = 38
"""Characters of a teacher's name in a chart."""

STEPS, MASTERED = "Environment steps", "Mastered test tasks (%)"
"""Titles of the axes that most charts have."""

PLAIN = Look(INK, "o", "-")
"""Look of marks that belong to no teacher."""

Array = NDArray[np.float64]


class Kind(StrEnum):
    """Quantities that an axis can have."""

    NUMBER = "number"
    STEPS = "steps"
    PERCENT = "percent"
    SHARE = "share"
    TASK = "task"
    NAMES = "names"
    TEACHERS = "teachers"
    COMPARISONS = "comparisons"


MOST_TICKS = 12
"""Largest number of whole numbers with a tick for each."""


@dataclass(frozen=True)
class Scale:
    """An axis of a panel.

    Attributes:
        title: name of the quantity with its unit; empty for none.
        kind: the quantity; rows are named by `rows`, a dimension of the task space has bounds.
        low: lower bound; None where the marks decide.
        high: upper bound; None where the marks decide.
        rows: titles of rows by key, at the places 0, 1, … ; their order is downwards on a vertical axis.
        last_tick: largest value with a tick, where marks lie beyond the values; None for all.
        whole: True if only whole numbers have ticks.
        grid: True for lines across the panel at the ticks.
        shown: False for an axis without line and ticks.
    """

    title: str = ""
    kind: Kind = Kind.NUMBER
    low: float | None = None
    high: float | None = None
    rows: Mapping[str, str] = field(default_factory=dict)
    last_tick: float | None = None
    whole: bool = False
    grid: bool = False
    shown: bool = True

    @property
    def bounded(self) -> bool:
        """True if both bounds are given."""
        return self.low is not None and self.high is not None

    @property
    def each_whole(self) -> bool:
        """True if the range is short enough for a tick at each whole number."""
        return self.whole and (self.high or 0) - (self.low or 0) <= MOST_TICKS


@dataclass(frozen=True)
class Colours:
    """A colour scale of values.

    Attributes:
        name: name of a scale in matplotlib and in plotly.
        low: value of its first colour.
        high: value of its last colour.
        title: name of the quantity.
        open: True if values lie beyond the ends.
        mark: value that is marked; None for none.
    """

    name: str
    low: float
    high: float
    title: str = ""
    open: bool = False
    mark: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Mark:
    """An element drawn in a panel.

    Attributes:
        look: colour, marker and dashes.
        name: entry of the legend; empty for none.
        teacher: teacher that it belongs to, which a reader of a page can leave out; empty for none.
        comparison: anchor of the comparison that it belongs to; empty for none.
        words: text of each point, or one for all.
        hover: text under the pointer, where ``{x}``, ``{y}``, ``{value}`` and ``{text}`` are the point's own,
            formatted as in ``{y:.1f}``; empty for none.
        about: identifier in vector files.
    """

    look: Look = PLAIN
    name: str = ""
    teacher: str = ""
    comparison: str = ""
    words: Sequence[str] = ()
    hover: str = ""
    about: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve(Mark):
    """A line with its band.

    Attributes:
        x: positions (n,).
        y: heights (n,); None for a band alone.
        low: lower ends of the band (n,); None for none.
        high: upper ends of the band (n,); None for none.
        n: number of runs behind each point (n,): the line is drawn fully where all of them are.
        fill: colour inside markers; that of the line if empty.
        width: width of the line, CSS pixels; lines under 1.5 have no markers.
        opacity: opacity of the band, in [0, 1].
    """

    x: Array
    y: Array | None = None
    low: Array | None = None
    high: Array | None = None
    n: NDArray[Any] | None = None
    fill: str = ""
    width: float = 2.0
    opacity: float = 0.17


@dataclass(frozen=True, eq=False, kw_only=True)
class Dots(Mark):
    """Points.

    Attributes:
        x: positions (n,).
        y: heights (n,).
        values: quantity that colours them (n,); None where the look does.
        colours: scale of `values`.
        size: diameter of each or of all, CSS pixels.
        hollow: True for rings.
        opacity: opacity in [0, 1].
        edge: colour of a fine outline; empty for none.
    """

    x: Sequence[float] | Array
    y: Sequence[float] | Array
    values: Sequence[float] | Array | None = None
    colours: Colours | None = None
    size: float | Array = 5.0
    hollow: bool = False
    opacity: float = 1.0
    edge: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Interval(Mark):
    """A mean with its interval along the horizontal axis.

    Attributes:
        x: mean; NaN for none at this moment.
        y: height.
        low: lower end; NaN for none.
        high: upper end; NaN for none.
        size: diameter of the mean's mark, CSS pixels; 0 for none.
        width: width of the line, CSS pixels.
        cap: length of the ends, CSS pixels.
    """

    x: float
    y: float
    low: float
    high: float
    size: float = 8.0
    width: float = 1.6
    cap: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Bar(Mark):
    """A horizontal bar from 0 to `x` at the height `y`."""

    x: float
    y: float
    height: float = 0.7
    opacity: float = 0.75


@dataclass(frozen=True, eq=False, kw_only=True)
class Cells(Mark):
    """A grid whose cells are coloured.

    Attributes:
        xs: centres of the columns (c,).
        ys: centres of the rows (r,).
        values: values by row and column (r, c); NaN for none.
        colours: scale of `values`.
    """

    xs: Array
    ys: Array
    values: Array
    colours: Colours


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed line.

    Attributes:
        xs: corners (n,), the first repeated at the end.
        ys: corners (n,).
        weight: fullness, in [0, 1].
        score: value that colours it; None where the look does.
    """

    xs: Array
    ys: Array
    weight: float = 0.5
    score: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Shapes(Mark):
    """Closed lines, the lowest first; `colours` is the scale of their scores."""

    outlines: Sequence[Outline]
    colours: Colours | None = None
    width: float = 1.6
    opacity: float = 0.13


@dataclass(frozen=True, eq=False, kw_only=True)
class Rule(Mark):
    """A line across the whole panel at `x` or at `y`, with its name at the end of a horizontal one."""

    x: float | None = None
    y: float | None = None
    width: float = 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Label(Mark):
    """A short text centred at a point, or on its right if `beside`."""

    x: float
    y: float
    text: str
    beside: bool = False


@dataclass(frozen=True, eq=False)
class StarRow:
    """Stars above a panel, at the steps where a line differs from its reference.

    Attributes:
        look: look of the line.
        fill: colour inside its markers.
        above: steps at which it is above the reference.
        below: steps at which it is below.
        about: identifier of the line in vector files.
    """

    look: Look
    fill: str
    above: Sequence[float]
    below: Sequence[float]
    about: str


@dataclass(frozen=True)
class Key:
    """An entry of the legend that explains a marker: full, or hollow."""

    marker: str
    name: str
    full: bool = True
    size: float = 5.0
    colour: str = INK


@dataclass(frozen=True, eq=False)
class Panel:
    """A pair of axes with marks.

    Attributes:
        x: horizontal axis.
        y: vertical axis.
        marks: the lowest first; of a panel with moments those at the end of runs.
        title: heading.
        subtitle: second line of the heading, smaller.
        side: name of its row of panels; only the first of a row shows it.
        teacher: teacher whose panel it is; empty for several.
        stars: rows of stars above it, the uppermost first.
        remark: reason why it is empty.
        frame: colour of a frame around it; empty for none.
        moments: steps, and `END`, at which it can be shown, in order; empty for one that stays.
        moment: the panel at one of `moments`; its marks are as many, and of the same kinds, at all of them.
    """

    x: Scale
    y: Scale
    marks: Sequence[Mark] = ()
    title: str = ""
    subtitle: str = ""
    side: str = ""
    teacher: str = ""
    stars: Sequence[StarRow] = ()
    remark: str = ""
    frame: str = ""
    moments: Sequence[Any] = ()
    moment: Callable[[Any], "Panel"] | None = None

    def at(self, moment: object) -> "Panel":
        """Return the panel as it is at a moment."""
        return self if self.moment is None else self.moment(moment)


class Legend(StrEnum):
    """Places of a legend."""

    TOP = "top"
    CORNER = "corner"
    BESIDE = "beside"
    NONE = "none"


@dataclass(frozen=True, eq=False)
class Chart:
    """A figure for paper, and one or several charts of a page.

    Attributes:
        name: name of its files, and identifier on a page.
        panels: row by row; None where there is none.
        title: content in a few words.
        caption: content and number of runs, for a page.
        heading: text above all panels on paper.
        note: text below all panels on paper.
        keys: entries of the legend that explain markers.
        legend: place of the legend.
        size: width and height on paper without the legend, in inches.
        letters: size of the letters on paper, in points.
        pixels: height of a panel on a page, CSS pixels; rows have a height of their own.
    """

    name: str
    panels: Sequence[Sequence[Any]]
    title: str = ""
    caption: str = ""
    heading: str = ""
    note: str = ""
    keys: Sequence[Key] = ()
    legend: Legend = Legend.TOP
    size: tuple[float, float] = (5.2, 3.5)
    letters: float = 8.5
    pixels: int = 330

    @property
    def all_panels(self) -> list[Any]:
        """Panels, row by row, without empty places."""
        return [panel for row in self.panels for panel in row if panel is not None]


def moving(at: Callable[[Any], Panel], moments: Sequence[Any], shown: Any) -> Panel:
    """Return the panel that `at` returns of the moment `shown`, to be shown at all `moments`."""
    return replace(at(shown), moments=moments, moment=at)


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` of the places 0 to `count` - 1, evenly spaced, both ends included."""
    places = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
    return [int(place) for place in places] if count else []


def grid(panels: Sequence[Panel], columns: int) -> list[list[Panel | None]]:
    """Return panels in rows of one length, the last one filled up with None."""
    columns = max(1, min(columns, len(panels)))
    filled: list[Panel | None] = [*panels, *[None] * (-len(panels) % columns)]
    return [filled[start : start + columns] for start in range(0, len(filled), columns)]


def require(table: pd.DataFrame, columns: Sequence[str], what: str) -> None:
    """Check that a table has rows and columns.

    Raises:
        ValueError: it has no rows, or lacks one of `columns`.
    """
    absent = [column for column in columns if column not in table]
    if absent:
        raise ValueError(f"{what}: expected the columns {', '.join(columns)}; {', '.join(absent)} not there")
    if table.empty:
        raise ValueError(f"expected {what} with at least one row: there is nothing to draw")


def require_unique(table: pd.DataFrame, keys: Sequence[str], what: str) -> None:
    """Check that no two rows share a place in a figure.

    Raises:
        ValueError: two rows have the same `keys`.
    """
    twice = table[table.duplicated(list(keys))]
    if len(twice):
        place = ", ".join(str(value) for value in twice.iloc[0][list(keys)])
        raise ValueError(
            f"{what}: expected one row for each {', '.join(keys)}, found several of {place}; select one "
            f"of the experiments, steps, bodies or students that are mixed there"
        )


def significant(tests: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `tests` with a p-value under 0.05 after Holm's correction, NaN excluded."""
    return tests[tests["holm"] < SIGNIFICANCE]
