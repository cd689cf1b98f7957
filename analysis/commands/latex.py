"""The report of a root for LaTeX: a document with all tables and figures, to be cut to a paper's needs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from analysis.baselines.catalogue import Sources
from analysis.commands.figures import write_figures
from analysis.commands.tables import write_tables
from analysis.tables.table import TableFormat

PREAMBLE = r"""\documentclass{article}
\usepackage[utf8]{inputenc}
\usepackage[T1]{fontenc}
\usepackage{booktabs}
\usepackage{graphicx}
\usepackage[margin=2cm,landscape]{geometry} % tables of five challenges are wide
\begin{document}
"""

END = r"\end{document}" + "\n"


@dataclass(frozen=True)
class LatexReport:
    """What `write_latex` made: the document, and what a reader must know before trusting it."""

    document: Path
    warnings: tuple[str, ...]


def write_latex(sources: Sources, folder: Path) -> LatexReport:
    """Writes the paper's tables and figures of a root, and a document that shows all of them.

    Args:
        sources: results roots and baselines with runs.
        folder: written to: ``report.tex``, ``tables/*.tex`` and ``figures/*.pdf``, with a PNG beside each.

    Raises:
        ResultsRootError: one of `sources` is not a results root.
    """
    tables = write_tables(sources, kind=TableFormat.LATEX, output=folder / "tables")
    figures = write_figures(sources, folder / "figures")
    drawn = [file for file in figures.files if file.suffix == ".pdf"]
    parts = [PREAMBLE, *map(_table, tables.files), *map(_figure, drawn), END]
    document = folder / "report.tex"
    document.write_text("\n".join(parts), encoding="utf-8")
    left_out = (f"left out: {text}" for text in figures.left_out)
    return LatexReport(document, tuple(dict.fromkeys(_of(tables.warnings, figures.warnings, left_out))))


def _of(*groups: Iterable[str]) -> Iterable[str]:
    return (text for group in groups for text in group)


def _table(file: Path) -> str:
    # A table may be wider than the page of this document; in a paper its author decides.
    return rf"\input{{tables/{file.name}}}" + "\n" + r"\clearpage"


def _figure(file: Path) -> str:
    # Without the ending: names have points of their own, as in "after-0.5", which braces keep together.
    lines = (
        r"\begin{figure}[p]",
        r"\centering",
        rf"\includegraphics[width=\linewidth,height=.85\textheight,keepaspectratio]{{{{figures/{file.stem}}}.pdf}}",
        rf"\caption{{\protect\detokenize{{{file.stem}}}}}",
        r"\end{figure}",
        r"\clearpage",
    )
    return "\n".join(lines)
