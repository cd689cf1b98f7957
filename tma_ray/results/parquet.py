"""Tables to Parquet bytes and back: the same rows give the same bytes, however they came together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from tma_ray.results.schema import SCHEMAS, Table

ROW_GROUP_ROWS: Final = 1 << 17
"""Rows of a row group: several runs' evaluations, and a few megabytes of episodes."""

_REPEATED: Final = {
    Table.EVALUATIONS: ("task_index", "task.list.element"),
    Table.CURRICULUM: ("step", "sample"),
}
"""Numbers that recur, smaller as a dictionary than in the encoding of their type."""


def encode(table: Table, rows: pa.Table) -> bytes:
    """Returns `rows` as a Parquet file; its bytes depend on their values and order only."""
    schema = SCHEMAS[table]
    # Dictionaries of ids are rebuilt in order of appearance, whatever the parts they came from held.
    columns = [_rebuilt(rows[field.name], field.type) for field in schema]
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.Table.from_arrays(columns, schema=schema),
        sink,
        row_group_size=ROW_GROUP_ROWS,
        compression="zstd",
        write_page_checksum=True,
        **_encodings(table, schema),
    )
    return bytes(sink.getvalue())


def decode(data: bytes, columns: Sequence[str] | None = None) -> pa.Table:
    """Returns the rows of a Parquet file, all columns or these in this order.

    Raises:
        OSError, pa.ArrowException: the bytes are no whole Parquet file.
    """
    file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
    rows = file.read(None if columns is None else list(columns), use_threads=False)
    return rows if columns is None else rows.select(columns)


def _rebuilt(column: pa.ChunkedArray, kind: pa.DataType) -> pa.Array:
    if pa.types.is_dictionary(kind):
        plain = column.cast(kind.value_type).combine_chunks()
        return plain.dictionary_encode().cast(kind)
    return column.combine_chunks()


def _encodings(table: Table, schema: pa.Schema) -> dict[str, Any]:
    leaves = [leaf for field in schema for leaf in _leaves(field.name, field.type)]
    repeated = _REPEATED.get(table, ())
    encoding = {path: _encoding(kind) for path, kind in leaves if path not in repeated}
    chosen = {path: name for path, name in encoding.items() if name}
    return {
        "column_encoding": chosen,
        "use_dictionary": [path for path, _ in leaves if path not in chosen],
    }


def _encoding(kind: pa.DataType) -> str | None:
    if pa.types.is_integer(kind) or pa.types.is_timestamp(kind):
        return "DELTA_BINARY_PACKED"
    if pa.types.is_floating(kind):
        return "BYTE_STREAM_SPLIT"
    return None


def _leaves(path: str, kind: pa.DataType) -> Iterator[tuple[str, pa.DataType]]:
    """Yields the Parquet columns that a column of this type becomes."""
    if pa.types.is_map(kind):
        yield from _leaves(f"{path}.key_value.key", kind.key_type)
        yield from _leaves(f"{path}.key_value.value", kind.item_type)
    elif pa.types.is_list(kind):
        yield from _leaves(f"{path}.list.element", kind.value_type)
    elif pa.types.is_struct(kind):
        for field in kind:
            yield from _leaves(f"{path}.{field.name}", field.type)
    else:
        yield path, kind
