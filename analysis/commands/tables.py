"""Files of the paper's tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

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
from analysis.tables.table import SUFFIXES, ResultTable, TableFormat, render


class Written(NamedTuple):
    """Files that were written.

    Attributes:
        files: files of tables; vector and PNG files, and GIFs, of figures.
        warnings: limits of the data, in sentences.
        text: all tables, one after the other.
        left_out: figures without enough data, with the reason.
    """

    files: tuple[Path, ...]
    warnings: tuple[str, ...]
    text: str = ""
    left_out: tuple[str, ...] = ()


def write_tables(
    sources: Sources,
    step: int | None = None,
    kind: TableFormat | str = TableFormat.MARKDOWN,
    output: Path | None = None,
) -> Written:
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
        tables, warnings = list(tables_of(frames, step)), frames.notes
        known = {table.name for table in result_tables(published_table_results())}
        absent = [name for name in sorted(known) if not any(each.name.startswith(name) for each in tables)]
        if absent:
            warnings = (*warnings, f"Nothing of these tables was run: {', '.join(absent)}.")
    texts = {f"{table.name}.{SUFFIXES[kind]}": render(table, kind) for table in tables}
    files = () if output is None else tuple(output / name for name in texts)
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(texts[file.name], encoding="utf-8")
    return Written(files, warnings, "\n".join(texts.values()))


def tables_of(frames: Frames, step: int | None = None) -> Iterator[ResultTable]:
    """Yield the tables of a root that have a cell, then hyper-parameters and needed knowledge."""
    for results in table_results(frames, step):
        yield from result_tables(results)
    yield hyperparameters(search_results(frames))
    yield knowledge_needs()
