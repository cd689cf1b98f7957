"""Tables of results before they are text: cells with numbers or words, which are best, what is missing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Cell:
    """One cell: the mean of a measure over runs, or words.

    Attributes:
        n: runs behind the numbers.
        mean: of them; NaN where the cell is empty.
        std: standard deviation over them; NaN where there is none.
        digits: decimals of `mean` that count; a standard deviation has one.
        words: what the cell says instead of numbers.
        missing: why it is empty, or why it is not of all the runs that belong here; else empty.
        doubt: why the number may be wrong; else empty.
        best: whether no other number of its column is higher as shown.
    """

    n: int = 0
    mean: float = math.nan
    std: float = math.nan
    digits: int = 1
    words: str = ""
    missing: str = ""
    doubt: str = ""
    best: bool = False

    @property
    def has_number(self) -> bool:
        """Whether there is a mean to show."""
        return math.isfinite(self.mean)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader must know about the cell."""
        doubt = f"doubtful: {self.doubt}" if self.doubt else ""
        return tuple(text for text in (self.missing, doubt) if text)


NOT_RUN = Cell(missing="not run")


@dataclass(frozen=True)
class Table:
    """A table of labelled rows and columns.

    Attributes:
        name: what its file is called, without ending.
        title: what it shows.
        head: what the rows are.
        rows: label of each row, by key, in order.
        columns: label of each column, by key, in order.
        cells: by key of row and column; where there is none, nothing was run.
        remarks: what holds for the whole table.
    """

    name: str
    title: str
    head: str
    rows: Mapping[str, str]
    columns: Mapping[str, str]
    cells: Mapping[tuple[str, str], Cell]
    remarks: tuple[str, ...] = field(default=())

    def cell(self, row: str, column: str) -> Cell:
        """Returns the cell of a row and column, `NOT_RUN` where there is none."""
        return self.cells.get((row, column), NOT_RUN)

    def column_cells(self, column: str) -> tuple[Cell, ...]:
        """Returns the cells of a column from top to bottom."""
        return tuple(self.cell(row, column) for row in self.rows)

    def notes(self) -> dict[str, str]:
        """Returns the marks of all notes of cells, a, b, ... by text, row after row."""
        cells = (self.cell(row, column) for row in self.rows for column in self.columns)
        texts = dict.fromkeys(note for cell in cells for note in cell.notes)
        return {text: _letters(place) for place, text in enumerate(texts)}


def with_best(table: Table, columns: Iterable[str] | None = None) -> Table:
    """Returns `table` with the highest numbers of its columns marked, or of some; ties share the mark.

    What reads the same is the same. A number that has no other beside it, or only equal ones, is not marked.
    """
    cells = dict(table.cells)
    for column in table.columns if columns is None else columns:
        shown = {
            row: round(cell.mean, cell.digits)
            for row in table.rows
            if (cell := table.cell(row, column)).has_number
        }
        highest = max(shown.values(), default=math.nan)
        if len(set(shown.values())) < 2:
            continue
        for row in (row for row, mean in shown.items() if mean == highest):
            cells[row, column] = replace(cells[row, column], best=True)
    return replace(table, cells=cells)


def _letters(place: int) -> str:
    """Returns a, b, ... z, aa, ab, ... for 0, 1, ..."""
    rest, letter = divmod(place, 26)
    return (_letters(rest - 1) if rest else "") + chr(ord("a") + letter)
