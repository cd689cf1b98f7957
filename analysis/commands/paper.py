"""Export of the paper's tables and figures, and of a LaTeX document with all of them."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from analysis.baselines.catalogue import Sources, published, read
from analysis.charts.paper.style import Vector, save
from analysis.comparisons.comparison import Measurements
from analysis.data.frames import Frames, object_strings
from analysis.figures import Drawing, drawings, published_drawings
from analysis.measures.evaluations import search_results
from analysis.tables.paper_tables import (
    hyperparameters,
    knowledge_needs,
    published_table_results,
    result_tables,
    table_results,
)
from analysis.tables.table import SUFFIXES, ResultTable, TableFormat, render
from analysis.teacher_styles import shown_together
from tma_ray.support.component_names import nearest


class Written(NamedTuple):
    """Written files, with warnings about missing data."""

    files: tuple[Path, ...]  # files of tables, or of figures (vector, PNG and GIF)
    warnings: tuple[str, ...]  # sentences about the limitations of the data
    text: str = ""  # content of all tables
    left_out: tuple[str, ...] = ()  # figures without enough data, each with the reason


def write_tables(
    sources: Sources,
    step: int | None = None,
    kind: TableFormat | str = TableFormat.MARKDOWN,
    output: Path | None = None,
) -> Written:
    """Return the paper's tables for a root, finished or not, and write them to `output` if it is given.

    Args:
        sources: folders, ``s3://`` or ``gs://`` addresses, names of baselines; ``paper-2021``, with the
            paper's own tables, cannot be combined with others.
        step: step at which runs are measured; None for their ends.
        kind: markdown, latex or csv.
        output: folder to write to; created if missing.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
        BaselineError: if a baseline is damaged.
        ValueError: if the step is below 1, or is given for published results.
    """
    if step is not None and step < 1:
        raise ValueError(f"step {step}: expected at least 1, or none for the ends of the runs")
    kind, baseline = TableFormat(kind), published(sources)
    if baseline is not None:
        if step is not None:
            raise ValueError(f"{sources} has results at the end of training only; leave out the step")
        results = published_table_results(baseline.published())
        tables, warnings = [*result_tables(results), hyperparameters(), knowledge_needs()], tuple[str, ...]()
    else:
        frames = read(sources)
        tables, warnings = list(tables_of(frames, step)), frames.notes
        names = sorted({table.name for table in result_tables(published_table_results())})
        absent = [name for name in names if not any(table.name.startswith(name) for table in tables)]
        if absent:
            warnings = (*warnings, f"Nothing of these tables was run: {', '.join(absent)}.")
    texts = {f"{table.name}.{SUFFIXES[kind]}": render(table, kind) for table in tables}
    files = () if output is None else tuple(output / name for name in texts)
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(texts[file.name], encoding="utf-8")
    return Written(files, warnings, "\n".join(texts.values()))


def tables_of(frames: Frames, step: int | None = None) -> Iterator[ResultTable]:
    """Yield the non-empty result tables of a root, then those of hyper-parameters and expert knowledge."""
    for results in table_results(frames, step):
        yield from result_tables(results)
    yield hyperparameters(search_results(frames))
    yield knowledge_needs()


@object_strings()
def write_figures(
    sources: Sources, output: Path, vector: Vector | str = Vector.PDF, only: str = ""
) -> Written:
    """Write the paper's figures for which a root or a baseline has enough data.

    Args:
        sources: folders, ``s3://`` or ``gs://`` addresses, names of baselines; ``paper-2021`` cannot be
            combined with others.
        output: folder to write to; created if missing.
        vector: pdf or svg; each figure is written as PNG, too.
        only: prefix of the names of figures, or of a part after a hyphen; empty for all figures.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
        ValueError: if the format is unknown, or no figure has such a name.
    """
    kind, baseline = Vector(vector), published(sources)
    if baseline is not None:
        return _write(list(published_drawings(baseline.published())), output, kind, only, ())
    frames = read(sources)
    with shown_together(frames.cells["teacher"]):
        return _write(list(drawings(Measurements(frames))), output, kind, only, frames.notes)


def _write(
    figures: list[Drawing], output: Path, kind: Vector, only: str, warnings: tuple[str, ...]
) -> Written:
    files: list[Path] = []
    left_out = []
    chosen = [drawing for drawing in figures if f"-{only}" in f"-{drawing.name}"]
    if only and not chosen:
        names = [drawing.name for drawing in figures]
        hint = nearest(only, names)
        raise ValueError(f"no figure's name begins with {only!r:.60}: {hint}known: {', '.join(names)}")
    output.mkdir(parents=True, exist_ok=True)
    for drawing in chosen:
        try:
            figure = drawing.draw()
        except ValueError as error:  # not enough data for this figure
            left_out.append(f"{drawing.name}: {error}")
            continue
        if isinstance(figure, bytes):
            files.append(output / f"{drawing.name}.gif")
            files[-1].write_bytes(figure)
        else:
            files += save(figure, output / drawing.name, kind)
    return Written(tuple(files), warnings, left_out=tuple(left_out))


PREAMBLE = r"""\documentclass{article}
\usepackage[utf8]{inputenc}
\usepackage[T1]{fontenc}
\usepackage{booktabs}
\usepackage{graphicx}
\usepackage[margin=2cm,landscape]{geometry} % tables of five challenges are wide
\begin{document}
"""

DOCUMENT_END = r"\end{document}" + "\n"


# Tables are not scaled, and may be wider than the page.
TABLE = r"""\input{tables/%s}
\clearpage"""

# Without the inner braces, LaTeX would take ".5" in a name such as "after-0.5" as the file's extension.
FIGURE = r"""\begin{figure}[p]
\centering
\includegraphics[width=\linewidth,height=.85\textheight,keepaspectratio]{{figures/%s}.pdf}
\caption{\protect\detokenize{%s}}
\end{figure}
\clearpage"""


def write_latex(sources: Sources, folder: Path) -> Written:
    """Write the paper's tables and figures for a root, and a document with all of them.

    Args:
        sources: results roots and baselines with runs.
        folder: folder of ``report.tex``, ``tables/*.tex`` and ``figures/*.pdf``, each with a PNG.

    Returns:
        The document.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
    """
    tables = write_tables(sources, kind=TableFormat.LATEX, output=folder / "tables")
    figures = write_figures(sources, folder / "figures")
    drawn = [file.stem for file in figures.files if file.suffix == ".pdf"]
    parts = [TABLE % file.name for file in tables.files] + [FIGURE % (stem, stem) for stem in drawn]
    document = folder / "report.tex"
    document.write_text("\n".join([PREAMBLE, *parts, DOCUMENT_END]), encoding="utf-8")
    left_out = [f"left out: {text}" for text in figures.left_out]
    return Written((document,), tuple(dict.fromkeys([*tables.warnings, *figures.warnings, *left_out])))
