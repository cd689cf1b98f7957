"""Export of the paper's tables."""

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
    """Written files, with warnings on missing data."""

    files: tuple[Path, ...]  # files of tables, or vector, PNG and GIF files of figures
    warnings: tuple[str, ...]  # sentences on limits of the data
    text: str = ""  # content of all tables
    left_out: tuple[str, ...] = ()  # figures without enough data, with the reason


def write_tables(
    sources: Sources,
    step: int | None = None,
    kind: TableFormat | str = TableFormat.MARKDOWN,
    output: Path | None = None,
) -> Written:
    """Return the paper's tables for a root, finished or not, and write them to `output` if it is given.

    Args:
        sources: folders, ``s3://`` or ``gs://`` addresses, names of baselines; ``paper-2021``, for the
            paper's own tables, only alone.
        step: step at which runs are measured; None for their ends.
        kind: markdown, latex or csv.
        output: folder to write to; made if missing.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
        BaselineError: if a baseline is damaged.
        ValueError: if the step is under 1, or is given for published results.
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
