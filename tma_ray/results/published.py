"""Tables of results that were published without their runs: one Parquet file of means and deviations."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from tma_ray.decoding import DamagedFileError
from tma_ray.results.rows import completed
from tma_ray.results.schema import SCHEMA_VERSION
from tma_ray.results.storage.store import Store
from tma_ray.results.unpacking import unpacked_sizes

PUBLISHED_FILE: Final = "published.parquet"

MOST_PUBLISHED_BYTES: Final = 2**26
"""Bytes in memory beyond which a table is none that anybody published."""

_NAMES = pa.list_(pa.field("element", pa.string(), nullable=False))
_PERCENT = {"unit": "% of the test tasks"}

PUBLISHED_SCHEMA: Final = pa.schema(
    [
        pa.field("environment", pa.string(), nullable=False),
        pa.field("challenge", pa.string(), nullable=False),
        pa.field("expert_knowledge", pa.string(), nullable=False),
        pa.field("embodiments", _NAMES, nullable=False),
        pa.field("students", _NAMES, nullable=False),
        pa.field("teacher", pa.string(), nullable=False),
        pa.field("n", pa.int64(), nullable=False, metadata={"unit": "runs"}),
        pa.field("mastered_percent_mean", pa.float64(), nullable=False, metadata=_PERCENT),
        pa.field("mastered_percent_std", pa.float64(), nullable=False, metadata=_PERCENT),
        pa.field("doubt", pa.string(), nullable=False),
        pa.field("steps", pa.int64(), nullable=False, metadata={"unit": "environment steps"}),
        pa.field("engine", pa.string(), nullable=False),
    ],
    metadata={"tma_ray.table": "published", "tma_ray.schema_version": str(SCHEMA_VERSION)},
)
"""One row is one entry of a table: runs of several bodies and students pooled, and why to doubt it, if so."""


def write_published(store: Store, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes published results as `PUBLISHED_FILE`.

    Raises:
        ValueError: a row without exactly the columns of `PUBLISHED_SCHEMA`.
    """
    names = set(PUBLISHED_SCHEMA.names)
    for row in rows:
        if set(row) != names:
            raise ValueError(
                f"a published result has the columns {', '.join(PUBLISHED_SCHEMA.names)}; got {row}"
            )
    sink = io.BytesIO()
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=PUBLISHED_SCHEMA)
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    store.write_bytes(PUBLISHED_FILE, sink.getvalue())


def read_published(store: Store) -> pa.Table:
    """Returns what `write_published` wrote.

    Raises:
        FileNotFoundError: there is none.
        DamagedFileError: the file lacks a column, or would take too much memory.
        OSError, pa.ArrowException: it is not a complete Parquet file.
    """
    data = pa.BufferReader(store.read_bytes(PUBLISHED_FILE))
    file = pq.ParquetFile(data, page_checksum_verification=True)
    names = file.schema_arrow.names
    if sum(unpacked_sizes(file, data, range(file.num_row_groups), names, ())) > MOST_PUBLISHED_BYTES:
        raise DamagedFileError(
            f"{store.where(PUBLISHED_FILE)} would take more than {MOST_PUBLISHED_BYTES:,} bytes"
        )
    table = file.read()
    try:
        return completed(PUBLISHED_SCHEMA, PUBLISHED_SCHEMA.names, table)
    except KeyError as error:
        raise DamagedFileError(f"{store.where(PUBLISHED_FILE)} has no column {error}") from error
