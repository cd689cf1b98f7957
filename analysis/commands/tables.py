"""Files of the paper's tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from analysis.baselines.catalogue import Sources, published, read
from analysis.data.frames import Frames
from analysis.measures.evaluations import search_results
from analysis.tables.paper_tables import (
    hyperparameters,
    knowledge_needs,
    published_table_results,
    result_tables,
    table_results,
)
from analysis.tables.table import ENDINGS, Table, TableFormat, render


@dataclass(frozen=True)
class WrittenTables:
    """Text and files of `write_tables`.

    Attributes:
        text: all tables, one after the other.
        files: a file for each table; empty without a folder to write to.
        warnings: limits of the data, in sentences.
    """

    text: str
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def write_tables(
    sources: Sources,
    step: int | None = None,
    kind: TableFormat | str = TableFormat.MARKDOWN,
    output: Path | None = None,
) -> WrittenTables:
    """Return the paper's tables of a root, finished or not, and write them to a folder if one is given.

    Args:
        sources: folders, ``s3://`` or ``gs://`` addresses, names of baselines; ``paper-2021``, for the
            paper's own tables, only alone.
        step: steps at which runs are read; None for their ends.
        kind: markdown, latex or csv.
        output: folder to write to; made if missing.

    Raises:
        ResultsRootError: no results root at that place.
        BaselineError: a damaged baseline.
        ValueError: a step under 1, or published results at another step than their last.
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
        tables = list(tables_of(frames, step))
        warnings = (*frames.notes, *_none_of(tables))
    texts = {f"{table.name}.{ENDINGS[kind]}": render(table, kind) for table in tables}
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (output / name).write_text(text, encoding="utf-8")
    files = () if output is None else tuple(output / name for name in texts)
    return WrittenTables("\n".join(texts.values()), files, warnings)


def tables_of(frames: Frames, step: int | None = None) -> Iterator[Table]:
    """Yield the tables of a root that have a cell, then hyper-parameters and needed knowledge."""
    for results in table_results(frames, step):
        yield from result_tables(results)
    yield hyperparameters(search_results(frames))
    yield knowledge_needs()


def _none_of(tables: list[Table]) -> Iterator[str]:
    known = {table.name for table in result_tables(published_table_results())}
    absent = sorted(name for name in known if not any(table.name.startswith(name) for table in tables))
    if absent:
        yield f"Nothing of these tables was run: {', '.join(absent)}."
