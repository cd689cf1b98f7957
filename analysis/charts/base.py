"""Charts as marks in panels, which `charts.paper` and `charts.page` render.

Each module of the package computes the `Chart` of one kind of figure. Renderers depend on marks and panels
alone, so a new figure is a single module.

Common arguments: `name` is a chart's identifier on a page, `heading` its title, `caption` its content and
number of runs, and `quantity` the title of the axis of values.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.statistics import SIGNIFICANCE
from analysis.teacher_styles import INK, TeacherStyle

END = "end"  # moment of an animation at the end of runs; all other moments are steps

ONE_COLUMN, TWO_COLUMNS, PAGE_WIDTH = 3.3, 6.9, 10.2
"""Widths of a paper's column, of both columns, and of a page on the screen, in inches."""

LEAST_PERCENT = 5.0
"""Smallest upper end of axes of percentages, so that one mastered task out of a hundred stays near 0."""

TEACHERS_PER_PANEL = 8  # maximum number of teachers in one panel, besides Random
LONGEST_NAME = 38  # maximum length of a teacher's name in a chart
STEPS, MASTERED = "Environment steps", "Mastered test tasks (%)"  # titles of axes
PLAIN = TeacherStyle(INK, "o", "-")  # style of marks without a teacher

Array = NDArray[np.float64]


class AxisKind(StrEnum):
    """Kind of quantity shown on an axis."""

    NUMBER = "number"
    STEPS = "steps"
    PERCENT = "percent"
    SHARE = "share"
    TASK = "task"
    NAMES = "names"
    TEACHERS = "teachers"
    COMPARISONS = "comparisons"


MOST_TICKS = 12  # an axis of whole numbers with a wider range has fewer ticks


@dataclass(frozen=True)
class PanelAxis:
    """Axis of a panel."""

    title: str = ""  # name of the quantity with its unit; empty for none
    kind: AxisKind = AxisKind.NUMBER  # kind of quantity on the axis
    low: float | None = None  # lower bound; None to fit the marks
    high: float | None = None  # upper bound; None to fit the marks
    rows: Mapping[str, str] = field(default_factory=dict)  # row titles by key, at the positions 0, 1, …
    last_tick: float | None = None  # upper limit of ticks; None for no limit
    whole: bool = False  # True if only whole numbers have ticks
    grid: bool = False  # True to draw grid lines at the ticks
    shown: bool = True  # False to hide the axis line and its ticks

    @property
    def bounded(self) -> bool:
        """True if both bounds are given."""
        return self.low is not None and self.high is not None

    @property
    def each_whole(self) -> bool:
        """True if every whole number has a tick."""
        return self.whole and (self.high or 0) - (self.low or 0) <= MOST_TICKS


@dataclass(frozen=True)
class ColourScale:
    """Colour scale for values from `low` to `high`."""

    name: str  # name of the scale in matplotlib and plotly
    low: float  # value mapped to the first colour
    high: float  # value mapped to the last colour
    title: str = ""  # name of the quantity
    open: bool = False  # True if values may lie beyond the ends
    mark: float | None = None  # value to mark on the colour bar; None for none


@dataclass(frozen=True, eq=False, kw_only=True)
class Mark:
    """Base class of the marks drawn in a panel."""

    look: TeacherStyle = PLAIN  # colour, marker and dashes
    name: str = ""  # legend entry; empty for no entry
    teacher: str = ""  # teacher by which pages hide the mark; empty for none
    comparison: str = ""  # anchor of the comparison by which pages hide the mark; empty for none
    texts: Sequence[str] = ()  # text of each point, or a single text for all points
    hover: str = ""  # template of the hover text, such as ``{x}, {y:.1f}, {value}, {text}``
    svg_id: str = ""  # identifier in SVG files; empty for none


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve(Mark):
    """Line, band around a line, or both."""

    x: Array  # x coordinates (n,)
    y: Array | None = None  # y coordinates (n,); None for a band alone
    low: Array | None = None  # lower ends of the band (n,); None for no band
    high: Array | None = None  # upper ends of the band (n,); None for no band
    n: NDArray[Any] | None = None  # runs per point (n,); the line is thinner where some runs are missing
    fill: str = ""  # fill colour of the markers; empty for the line's colour
    width: float = 2.0  # width of the line, in CSS pixels; lines thinner than 1.5 have no markers
    opacity: float = 0.17  # opacity of the band, in [0, 1]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scatter(Mark):
    """Points of a scatter plot."""

    x: Sequence[float] | Array  # x coordinates (n,)
    y: Sequence[float] | Array  # y coordinates (n,)
    values: Sequence[float] | Array | None = None  # values on the colour scale (n,)
    colours: ColourScale | None = None  # colour scale of `values`
    size: float | Array = 5.0  # diameters (n,), or a common diameter, in CSS pixels
    hollow: bool = False  # True to draw rings, not discs
    opacity: float = 1.0  # opacity in [0, 1]
    edge: str = ""  # colour of a fine outline; empty for no outline


@dataclass(frozen=True, eq=False, kw_only=True)
class Interval(Mark):
    """Mean with a horizontal interval."""

    x: float  # mean; NaN if missing
    y: float  # y coordinate
    low: float  # lower end of the interval; NaN if missing
    high: float  # upper end of the interval; NaN if missing
    size: float = 8.0  # diameter of the mean's marker, in CSS pixels; 0 for no marker
    width: float = 1.6  # width of the line, in CSS pixels
    cap: float = 0.0  # length of the caps, in CSS pixels


@dataclass(frozen=True, eq=False, kw_only=True)
class Bar(Mark):
    """Horizontal bar from 0 to `x` at the height `y`."""

    x: float
    y: float
    height: float = 0.7
    opacity: float = 0.75


@dataclass(frozen=True, eq=False, kw_only=True)
class Heatmap(Mark):
    """Grid of coloured cells."""

    xs: Array  # centres of the columns (c,)
    ys: Array  # centres of the rows (r,)
    values: Array  # values by row and column (r, c); NaN if missing
    colours: ColourScale  # colour scale of `values`


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of a polygon."""

    xs: Array  # x coordinates of the corners (n,), the first repeated at the end
    ys: Array  # y coordinates of the corners (n,)
    weight: float = 0.5  # opacity of the fill, in [0, 1]
    score: float | None = None  # value on the colour scale; None for the mark's own colour


@dataclass(frozen=True, eq=False, kw_only=True)
class Polygons(Mark):
    """Polygons, optionally coloured by score, bottom layer first."""

    outlines: Sequence[Outline]
    colours: ColourScale | None = None
    width: float = 1.6
    opacity: float = 0.13


@dataclass(frozen=True, eq=False, kw_only=True)
class ReferenceLine(Mark):
    """Line across the whole panel at `x` or at `y`."""

    x: float | None = None
    y: float | None = None
    width: float = 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Label(Mark):
    """Short text centred at a point, or to its right if `beside`."""

    x: float
    y: float
    text: str
    beside: bool = False


@dataclass(frozen=True, eq=False)
class StarRow:
    """Row of stars above a panel, at the steps where a line differs from its reference."""

    look: TeacherStyle  # style of the line
    fill: str  # fill colour of the line's markers
    above: Sequence[float]  # steps at which the line is above the reference
    below: Sequence[float]  # steps at which the line is below the reference
    svg_id: str  # identifier in SVG files; empty for none


@dataclass(frozen=True)
class LegendEntry:
    """Legend entry for a filled or hollow marker."""

    marker: str
    name: str
    full: bool = True
    size: float = 5.0
    colour: str = INK


@dataclass(frozen=True, eq=False)
class Panel:
    """Axes with the marks drawn in them."""

    x: PanelAxis  # horizontal axis
    y: PanelAxis  # vertical axis
    marks: Sequence[Mark] = ()  # marks, bottom layer first
    title: str = ""  # heading
    subtitle: str = ""  # second line of the heading, smaller
    side: str = ""  # title of the row of panels; only the first panel of a row shows it
    teacher: str = ""  # teacher of the panel; empty for several
    stars: Sequence[StarRow] = ()  # rows of stars above the panel, the uppermost first
    empty_text: str = ""  # text shown in an empty panel
    frame: str = ""  # colour of a frame; empty for no frame
    moments: Sequence[Any] = ()  # steps and `END` of an animated panel, in order; empty for a static one
    moment: Callable[[Any], "Panel"] | None = None  # function that returns the panel at one of `moments`

    def at(self, moment: object) -> "Panel":
        """Return the panel at a moment of its animation."""
        return self if self.moment is None else self.moment(moment)


class Legend(StrEnum):
    """Position of a legend."""

    TOP = "top"
    CORNER = "corner"
    BESIDE = "beside"
    NONE = "none"


@dataclass(frozen=True, eq=False)
class Chart:
    """Chart: panels with titles and a legend, for a paper or a page."""

    name: str  # file name without suffix, and identifier on a page
    panels: Sequence[Sequence[Any]]  # panels by row; None for a gap
    title: str = ""  # title on a page
    caption: str = ""  # caption on a page: content and number of runs
    heading: str = ""  # text above all panels on paper
    note: str = ""  # text below all panels on paper
    keys: Sequence[LegendEntry] = ()  # legend entries for markers
    legend: Legend = Legend.TOP  # position of the legend
    size: tuple[float, float] = (5.2, 3.5)  # width and height on paper without the legend, in inches
    letters: float = 8.5  # font size on paper, in points
    pixels: int = 330  # height on a page of a panel whose axes have no rows, in CSS pixels

    @property
    def all_panels(self) -> list[Any]:
        """Panels by row, without gaps."""
        return [panel for row in self.panels for panel in row if panel is not None]


def animated(at: Callable[[Any], Panel], moments: Sequence[Any], shown: Any) -> Panel:
    """Return a panel that is animated over `moments`, initially at the moment `shown`."""
    return replace(at(shown), moments=moments, moment=at)


def spaced_indices(count: int, most: int) -> list[int]:
    """Return at most `most` evenly spaced indices of `count` items, including both ends."""
    indices = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
    return indices.tolist() if count else []


def grid(panels: Sequence[Panel], columns: int) -> list[list[Panel | None]]:
    """Arrange panels in rows of equal length, with the last row padded with None."""
    columns = max(1, min(columns, len(panels)))
    filled: list[Panel | None] = [*panels, *[None] * (-len(panels) % columns)]
    return [filled[start : start + columns] for start in range(0, len(filled), columns)]


def check_table(table: pd.DataFrame, columns: Sequence[str], what: str) -> None:
    """Check that a table has the given columns and at least one row.

    Raises:
        ValueError: if it has no rows, or lacks one of `columns`.
    """
    absent = [column for column in columns if column not in table]
    if absent:
        raise ValueError(f"{what}: expected the columns {', '.join(columns)}; {', '.join(absent)} not there")
    if table.empty:
        raise ValueError(f"expected {what} with at least one row: there is nothing to draw")


def check_unique(table: pd.DataFrame, keys: Sequence[str], what: str) -> None:
    """Check that no two rows of a table have the same keys.

    Raises:
        ValueError: if two rows have the same `keys`.
    """
    twice = table[table.duplicated(list(keys))]
    if len(twice):
        values = ", ".join(str(value) for value in twice.iloc[0][list(keys)])
        raise ValueError(
            f"{what}: expected one row for each {', '.join(keys)}, found several of {values}; select one "
            f"of the experiments, steps, bodies or students that are mixed there"
        )


def significant(tests: pd.DataFrame) -> pd.DataFrame:
    """Return the tests that are significant after Holm's correction."""
    return tests[tests["holm"] < SIGNIFICANCE]
