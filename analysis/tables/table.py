"""Tables of results as Markdown, LaTeX and CSV."""

import csv
import io
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from analysis.formatting import number
from tma_ray.support.texts import counted


@dataclass(frozen=True)
class TableCell:
    """Cell of a `ResultTable`: a mean with its standard deviation, or words.

    Attributes:
        n: number of runs.
        mean: mean over runs; NaN if missing.
        std: standard deviation over runs; NaN if missing.
        digits: decimals of `mean`; a standard deviation has one.
        words: text in place of numbers.
        missing: reason for a missing number or missing runs; empty if there is none.
        doubt: reason for doubts about the number; empty if there is none.
        best: True for the highest number of a column.
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
        """True if there is a mean to show."""
        return math.isfinite(self.mean)

    @property
    def notes(self) -> tuple[str, ...]:
        """Footnotes of the cell."""
        doubt = f"doubtful: {self.doubt}" if self.doubt else ""
        return tuple(text for text in (self.missing, doubt) if text)


NOT_RUN = TableCell(missing="not run")


@dataclass(frozen=True)
class ResultTable:
    """Table with labelled rows and columns.

    Attributes:
        name: file name without suffix.
        title: title of the table.
        head: heading of the rows' labels.
        rows: labels of rows by key, in order.
        columns: labels of columns by key, in order.
        cells: cells by keys of row and column; `NOT_RUN` by default.
        remarks: remarks on the whole table.
    """

    name: str
    title: str
    head: str
    rows: Mapping[str, str]
    columns: Mapping[str, str]
    cells: Mapping[tuple[str, str], TableCell]
    remarks: tuple[str, ...] = ()

    def cell(self, row: str, column: str) -> TableCell:
        """Return the cell of a row and a column."""
        return self.cells.get((row, column), NOT_RUN)

    def column_cells(self, column: str) -> tuple[TableCell, ...]:
        """Return the cells of a column from top to bottom."""
        return tuple(self.cell(row, column) for row in self.rows)

    def counts(self, column: str) -> set[int]:
        """Return the distinct numbers of runs behind a column."""
        return {cell.n for cell in self.column_cells(column) if cell.has_number}

    def numeric(self, column: str) -> bool:
        """Return True if a column has numbers and no words."""
        return bool(self.counts(column)) and not any(cell.words for cell in self.column_cells(column))

    def notes(self) -> dict[str, str]:
        """Return the letter (a, b, ...) of each of the table's footnotes, by its text."""
        cells = (self.cell(row, column) for row in self.rows for column in self.columns)
        texts = dict.fromkeys(note for cell in cells for note in cell.notes)
        return {text: _letters(index) for index, text in enumerate(texts)}


def with_best(table: ResultTable, columns: Iterable[str] | None = None) -> ResultTable:
    """Mark the highest number (after rounding) in each of `columns` (by default all) as best.

    Columns whose numbers are all equal have no mark.
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


def _letters(index: int) -> str:
    """Return a, b, ... z, aa, ab, ... for 0, 1, ..."""
    rest, letter = divmod(index, 26)
    return (_letters(rest - 1) if rest else "") + chr(ord("a") + letter)


DASH = "\N{EN DASH}"


class TableFormat(StrEnum):
    """Output format of tables."""

    MARKDOWN = "markdown"
    LATEX = "latex"
    CSV = "csv"


SUFFIXES = {TableFormat.MARKDOWN: "md", TableFormat.LATEX: "tex", TableFormat.CSV: "csv"}

CSV_COLUMNS = ["table", "row", "column", "n", "mean", "std", "best", "words", "missing", "doubt"]


def render(table: ResultTable, kind: TableFormat) -> str:
    """Render a table as a string that ends with a newline.

    Markdown and LaTeX (with the package booktabs) have the best cells in bold, dashes for missing numbers,
    notes below, and numbers of runs of the table, each column or each cell. CSV has a line per cell.
    """
    return {TableFormat.CSV: _csv, TableFormat.MARKDOWN: _markdown, TableFormat.LATEX: _latex}[kind](table)


class _Marks(NamedTuple):
    """Markup of table cells in Markdown or in LaTeX."""

    escape: Callable[[str], str]
    bold: Callable[[str], str]
    note: Callable[[str], str]
    plus_minus: str


_MARKDOWN = _Marks(
    escape=lambda text: re.sub(r"([\\`*_|<>\[\]#$~])", r"\\\1", " ".join(text.split())),
    bold="**{}**".format,
    note="<sup>{}</sup>".format,
    plus_minus=" \N{PLUS-MINUS SIGN} ",
)

_LATEX_SPECIAL = {character: rf"\{character}" for character in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "\N{PLUS-MINUS SIGN}": r"$\pm$",
    "\N{EN DASH}": "--",
    "\N{MINUS SIGN}": "$-$",
}

_LATEX = _Marks(
    escape=lambda text: "".join(_LATEX_SPECIAL.get(letter, letter) for letter in " ".join(text.split())),
    bold=r"\textbf{{{}}}".format,
    note=r"\textsuperscript{{{}}}".format,
    plus_minus=r" $\pm$ ",
)


def pipe_table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Collection[int] = ()) -> str:
    """Return rows of strings as a Markdown table, with the columns at indices `numbers` right-aligned."""
    rule = ["---:" if index in numbers else "---" for index in range(len(head))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))


def _markdown(table: ResultTable) -> str:
    head, *rows = _grid(table, _MARKDOWN)
    numbers = [index for index, column in enumerate(table.columns, start=1) if table.numeric(column)]
    title = f"### {_MARKDOWN.escape(table.title)}"
    return "\n\n".join([title, pipe_table(head, rows, numbers), *_below(table, _MARKDOWN)]) + "\n"


def _latex(table: ResultTable) -> str:
    alignment = "l" + "".join("r" if table.numeric(column) else "l" for column in table.columns)
    head, *body = (f"{' & '.join(cells)} \\\\" for cells in _grid(table, _LATEX))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_LATEX.escape(table.title)}.}}",
        rf"\label{{tab:{table.name.replace('_', '-')}}}",
        rf"\begin{{tabular}}{{{alignment}}}",
        *(r"\toprule", head, r"\midrule", *body, r"\bottomrule"),
        r"\end{tabular}",
    ]
    lines += [rf"\par\smallskip\footnotesize {text}" for text in _below(table, _LATEX)]
    return "\n".join([*lines, r"\end{table}"]) + "\n"


def _csv(table: ResultTable) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row, column in itertools.product(table.rows, table.columns):
        cell = table.cell(row, column)
        numbers = ["" if math.isnan(value) else repr(float(value)) for value in (cell.mean, cell.std)]
        runs, best = cell.n if cell.has_number else "", "yes" if cell.best else ""
        words = [cell.words, cell.missing, cell.doubt]
        writer.writerow([table.name, row, column, runs, *numbers, best, *words])
    return text.getvalue()


def _grid(table: ResultTable, marks: _Marks) -> Iterator[list[str]]:
    """Yield the header and the rows of a table, as lists of strings with markup."""
    counts = {column: table.counts(column) for column in table.columns}
    same_everywhere = len(set().union(*counts.values())) < 2
    labels = [marks.escape(table.head)]
    for column, title in table.columns.items():
        with_count = len(counts[column]) == 1 and not same_everywhere
        labels.append(marks.escape(title) + (f" (n = {min(counts[column])})" if with_count else ""))
    yield labels
    notes = table.notes()
    for row, title in table.rows.items():
        cells = [marks.escape(title)]
        for column in table.columns:
            cell = table.cell(row, column)
            text = marks.escape(cell.words or DASH)
            if cell.has_number:
                text = marks.escape(number(cell.mean, cell.digits))
                text += marks.plus_minus + number(cell.std) if math.isfinite(cell.std) else ""
                text = marks.bold(text) if cell.best else text
                text += f" (n = {cell.n})" if len(counts[column]) > 1 else ""
            letters = ",".join(notes[note] for note in cell.notes)
            cells.append(text + (marks.note(letters) if letters else ""))
        yield cells


def _below(table: ResultTable, marks: _Marks) -> Iterator[str]:
    """Yield the lines below a table: remarks, numbers of runs, footnotes."""
    counts: set[int] = set().union(*(table.counts(column) for column in table.columns))
    remarks = [f"{counted(min(counts), 'run')} each."] if len(counts) == 1 else []
    if any(cell.best for cell in table.cells.values()):
        remarks.append("Bold: the highest mean of its column, without a test.")
    if remarks or table.remarks:
        yield marks.escape(" ".join([*table.remarks, *remarks]))
    for text, letter in table.notes().items():
        yield f"{marks.note(letter)} {marks.escape(text)}"
