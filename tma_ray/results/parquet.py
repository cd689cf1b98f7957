"""Deterministic encoding of Parquet files, and decoding with memory limits."""

import io
import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, Final, TypeAlias

import pyarrow as pa
import pyarrow.parquet as pq

from tma_ray.results.schema import SCHEMA_VERSION, SCHEMAS, Table, completed, selected
from tma_ray.results.storage import Store
from tma_ray.support.decoding import MOST_FILE_BYTES, DamagedFileError

_Fields: TypeAlias = dict[int, Any]  # fields of a Thrift structure by number
PAGE_BYTES: Final = 1024  # added to the size of every page, since even empty pages take time
_VALUE_BYTES: Final = 8  # size of a number, or of the offset of a string

_NUMBERS: Final = ("BOOLEAN", "INT32", "INT64", "FLOAT", "DOUBLE")
_PLAIN, _LENGTHS_APART, _BY_DICTIONARY = 0, 6, (2, 8)  # Parquet's encodings
_SIZE, _PACKED_SIZE, _DATA, _DICTIONARY, _DATA_2 = 2, 3, 5, 7, 8  # fields of a page header
_BOOLEANS, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _STRUCTURE = (1, 2), 3, (4, 5, 6), 7, 8, 12  # Thrift types


def unpacked_sizes(
    file: pq.ParquetFile, source: Any, groups: Iterable[int], columns: Collection[str], kept: Collection[str]
) -> Iterator[int]:
    """Yield an upper bound, in bytes, on the memory of each page of the given row groups and columns.

    Arrow only checks page headers while it allocates, and small forged pages may unpack to any size. `source`
    is the open file, with a method `read_at`; `kept` are string columns to keep dictionary-encoded.
    """
    for group in map(file.metadata.row_group, groups):
        for chunk in map(group.column, range(group.num_columns)):
            if not chunk.num_values or chunk.path_in_schema.partition(".")[0] not in columns:
                continue  # the pages of this column are not read
            stays = chunk.physical_type == "BYTE_ARRAY" and chunk.path_in_schema in kept
            largest = 0
            for page in _pages(source, chunk):
                if _DICTIONARY in page:
                    largest = 0 if stays else page[_SIZE]
                encoding = page.get(_DATA_2, {}).get(4, page.get(_DATA, {}).get(2, _PLAIN))
                if chunk.physical_type in _NUMBERS or encoding in (_PLAIN, _LENGTHS_APART):
                    size = page[_SIZE] + _VALUE_BYTES * _count(page)
                else:  # strings of at most `most` bytes each
                    most = largest if encoding in _BY_DICTIONARY else page[_SIZE]
                    size = _count(page) * (_VALUE_BYTES + most)
                yield PAGE_BYTES + size


def _count(page: _Fields) -> int:
    content = page.get(_DATA) or page.get(_DATA_2) or page.get(_DICTIONARY) or {}
    return int(content.get(1, 0))


def _pages(source: Any, chunk: Any) -> Iterator[_Fields]:
    """Yield the page headers of a column chunk."""
    offset = chunk.data_page_offset
    if chunk.has_dictionary_page:
        offset = min(offset, chunk.dictionary_page_offset or offset)
    end = offset + chunk.total_compressed_size
    while offset < end:
        for most in (512, 1 << 16):  # few headers exceed the first size
            with suppress(IndexError, RecursionError):
                page, size = _structure(source.read_at(most, offset), 0)
                break
        else:
            raise DamagedFileError(f"no page begins at {offset:,}")
        if min(page.get(_SIZE, -1), page.get(_PACKED_SIZE, -1), _count(page)) < 0:
            raise DamagedFileError(f"a page at {offset:,} tells no size")
        yield page
        offset += size + page[_PACKED_SIZE]


def _structure(data: bytes, offset: int) -> tuple[_Fields, int]:
    """Parse a Thrift structure (compact protocol); return its integers and nested structures, and its end."""
    fields: _Fields = {}
    number = 0
    while data[offset]:
        kind, step = data[offset] & 15, data[offset] >> 4
        offset += 1
        if step:
            number += step
        else:
            number, offset = _integer(data, offset)
        if kind == _STRUCTURE:
            fields[number], offset = _structure(data, offset)
        elif kind in _INTEGERS:
            fields[number], offset = _integer(data, offset)
        elif kind == _BINARY:
            size, offset = _unsigned(data, offset)
            offset += size
        elif kind in (_BYTE, _DOUBLE):
            offset += 1 if kind == _BYTE else 8
        elif kind not in _BOOLEANS:
            raise DamagedFileError(f"a page's header has a field of kind {kind}, which none has")
    return fields, offset + 1


def _integer(data: bytes, offset: int) -> tuple[int, int]:
    value, offset = _unsigned(data, offset)
    return (value >> 1) ^ -(value & 1), offset


def _unsigned(data: bytes, offset: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[offset] & 127) << shift
        shift += 7
        offset += 1
        if data[offset - 1] < 128:
            return value, offset


ROW_GROUP_ROWS: Final = 1 << 17  # rows per row group: a few megabytes of episodes

MOST_TABLE_ROWS: Final = {
    table: 2_000_000 if table in (Table.RUNS, Table.ATTEMPTS, Table.CELLS) else 500_000_000 for table in Table
}
"""Limit on the number of rows of a file; small files may have many, since repeated rows compress well."""

MOST_ROW_BYTES: Final = {
    table: 2**20 if table in (Table.RUNS, Table.TEACHER_LOG) else 2**16 for table in Table
}
"""Limit on the mean bytes of a row in memory, counting at least 1,000 rows."""

MOST_UNPACKED_BYTES: Final = {Table.RUNS: 2**30, Table.ATTEMPTS: 2**28, Table.CELLS: 2**28}
"""Limit on the bytes of a file in memory; half of `MOST_FILE_BYTES` for other tables."""

_REPEATED: Final = {
    Table.EVALUATIONS: ("task_index", "task.list.element"),
    Table.CURRICULUM: ("step", "sample"),
}
"""Columns of recurring numbers, which take the least space dictionary-encoded."""


def encode(table: Table, rows: pa.Table) -> bytes:
    """Return `rows` as a Parquet file with bytes that depend only on their values and order."""
    sink = pa.BufferOutputStream()
    pq.write_table(_canonical(table, rows), sink, row_group_size=ROW_GROUP_ROWS, **_options(table))
    return bytes(sink.getvalue())


def encode_together(table: Table, parts: Iterable[pa.Table]) -> bytes:
    """Return the concatenated rows of `parts` as a Parquet file, keeping only few parts in memory.

    Parts are not split between row groups unless too large for one, so that they can be read separately.
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, SCHEMAS[table], **_options(table)) as writer:
        group: list[pa.Table] = []
        for part in parts:
            if group and sum(map(len, group)) + len(part) > ROW_GROUP_ROWS:
                _write_group(writer, table, group)
                group = []
            group.append(part)
        _write_group(writer, table, group)
    return bytes(sink.getvalue())


def decode_rows(table: Table, file: Any, first: int, count: int, columns: Sequence[str]) -> pa.Table:
    """Return `count` rows from row `first` of an open Parquet file, reading only their row groups.

    Errors are those of `decode`, and an IndexError if the file has too few rows.
    """
    parquet = _opened(table, file)
    ends = list(
        itertools.accumulate(parquet.metadata.row_group(i).num_rows for i in range(parquet.num_row_groups))
    )
    if first + count > (ends[-1] if ends else 0):
        raise IndexError(f"it has {parquet.metadata.num_rows} rows, not {first + count}")
    groups = [i for i, end in enumerate(ends) if end > first and (i == 0 or ends[i - 1] < first + count)]
    names = _present(parquet, columns)
    _check_size(table, parquet, file, groups, names, count + 2 * ROW_GROUP_ROWS)
    skipped = ends[groups[0] - 1] if groups and groups[0] else 0
    rows = parquet.read_row_groups(groups, names, use_threads=False)
    return _completed(table, columns, rows).slice(first - skipped, count)


def decode(
    table: Table,
    data: bytes,
    columns: Sequence[str] | None = None,
    count: int | None = None,
    *,
    checked: bool = False,
) -> pa.Table:
    """Return the rows of a Parquet file.

    Args:
        table: table of the rows.
        data: content of the file.
        columns: columns to read, in this order; all if None.
        count: expected number of rows; any number up to `MOST_TABLE_ROWS` if None.
        checked: True if the checksum of `data` was verified, so that page checksums are skipped.

    Raises:
        OSError: if it is not a complete Parquet file.
        pa.ArrowException: if it is not a Parquet file of this table.
        DamagedFileError: if it lacks a column, has another number of rows, or is too large.
    """
    source = pa.BufferReader(data)
    file = _opened(table, source, checked=checked)
    rows = file.metadata.num_rows
    if count is not None and rows != count:
        raise DamagedFileError(f"it has {rows} rows, but its manifest says {count}")
    names = SCHEMAS[table].names if columns is None else columns
    present = _present(file, names)
    _check_size(table, file, source, range(file.num_row_groups), present, MOST_TABLE_ROWS[table])
    return _completed(table, names, file.read(present, use_threads=False))


def opened(data: bytes) -> pq.ParquetFile:
    """Open a Parquet file, reading only its metadata."""
    return pq.ParquetFile(pa.BufferReader(data))


def unreadable_rows(table: Table, data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the range of rows of each row group with a damaged page."""
    source = pa.BufferReader(data)
    file, first = _opened(table, source), 0
    for group in range(file.num_row_groups):
        count = file.metadata.row_group(group).num_rows
        try:
            _check_size(table, file, source, [group], file.schema_arrow.names, MOST_TABLE_ROWS[table])
            file.read_row_group(group, use_threads=False)
        except (OSError, pa.ArrowException, DamagedFileError):
            yield first, first + count
        first += count


def same_rows(table: Table, rows: pa.Table, others: pa.Table) -> bool:
    """Return True if two tables have the same rows in the same order, where NaN equals NaN."""
    alike = _canonical(table, rows).equals(_canonical(table, others))
    return alike or encode(table, rows) == encode(table, others)  # compare bytes, since NaN != NaN


def _opened(table: Table, source: Any, *, checked: bool = False) -> pq.ParquetFile:
    """Open a Parquet file for reading, with dictionary-encoded id columns."""
    metadata = pq.read_metadata(source)
    ids = [name for name in _ids(table) if name in metadata.schema.names]  # older files lack some id columns
    return pq.ParquetFile(
        source, metadata=metadata, page_checksum_verification=not checked, read_dictionary=ids
    )


def _ids(table: Table) -> list[str]:
    return [field.name for field in SCHEMAS[table] if pa.types.is_dictionary(field.type)]


def _check_size(
    table: Table,
    file: pq.ParquetFile,
    source: Any,
    groups: Sequence[int],
    columns: Sequence[str],
    most_rows: int,
) -> None:
    """Raise a DamagedFileError if the given columns of the given row groups would take too much memory."""
    rows = sum(file.metadata.row_group(group).num_rows for group in groups)
    if rows > most_rows:
        raise DamagedFileError(f"it claims {rows:,} rows, more than {most_rows:,} of {table}")
    most = min(MOST_ROW_BYTES[table] * max(rows, 1_000), MOST_UNPACKED_BYTES.get(table, MOST_FILE_BYTES // 2))
    sizes = itertools.accumulate(unpacked_sizes(file, source, groups, columns, _ids(table)))
    if any(size > most for size in sizes):
        raise DamagedFileError(f"its {rows:,} rows of {table} would take more than {most:,} bytes of memory")


def _present(file: pq.ParquetFile, columns: Sequence[str]) -> list[str]:
    """Return the `columns` that `file` has, or its first column if it has none of them, to count rows."""
    names = file.schema_arrow.names
    return [name for name in columns if name in names] or names[:1]


def _completed(table: Table, columns: Sequence[str], rows: pa.Table) -> pa.Table:
    if rows.schema.equals(_selected(table, tuple(columns))):  # fast path for the usual case
        return rows
    try:
        return completed(SCHEMAS[table], columns, rows)
    except KeyError as error:
        raise DamagedFileError(f"it has no column {error}, which {table} has always had") from error


@cache
def _selected(table: Table, columns: tuple[str, ...]) -> pa.Schema:
    return selected(SCHEMAS[table], columns)


def _write_group(writer: pq.ParquetWriter, table: Table, parts: Sequence[pa.Table]) -> None:
    rows = _canonical(table, pa.concat_tables([SCHEMAS[table].empty_table(), *parts]).unify_dictionaries())
    if len(rows):
        writer.write_table(rows, row_group_size=ROW_GROUP_ROWS)


def _canonical(table: Table, rows: pa.Table) -> pa.Table:
    """Return `rows` with the dictionaries of id columns in order of first appearance."""
    columns = []
    for field in SCHEMAS[table]:
        column = rows[field.name]
        if pa.types.is_dictionary(field.type):
            plain = column.cast(field.type.value_type).combine_chunks()
            columns.append(plain.dictionary_encode().cast(field.type))
        else:
            columns.append(column.combine_chunks())
    return pa.Table.from_arrays(columns, schema=SCHEMAS[table])


def _options(table: Table) -> dict[str, Any]:
    """Return the writer options for a table: compression, page checksums and column encodings."""
    dictionaries, encodings = [], {}
    for path, kind in (leaf for field in SCHEMAS[table] for leaf in _leaves(field.name, field.type)):
        if path in _REPEATED.get(table, ()):
            dictionaries.append(path)
        elif pa.types.is_integer(kind) or pa.types.is_timestamp(kind):
            encodings[path] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(kind):
            encodings[path] = "BYTE_STREAM_SPLIT"
        else:
            dictionaries.append(path)
    return {
        "compression": "zstd",
        "write_page_checksum": True,
        "column_encoding": encodings,
        "use_dictionary": dictionaries,
    }


def _leaves(path: str, kind: pa.DataType) -> Iterator[tuple[str, pa.DataType]]:
    """Yield the path and type of each leaf of a nested column."""
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


PUBLISHED_FILE: Final = "published.parquet"

MOST_PUBLISHED_BYTES: Final = 2**26  # limit on the memory that published results take when read

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
"""Schema of published results: one pooled entry of a paper's table per row, with doubts about it."""


def write_published(store: Store, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write published results, or raise a ValueError if columns differ from `PUBLISHED_SCHEMA`."""
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
    """Return published results, as written by `write_published`.

    Raises:
        OSError: if the file is missing or incomplete.
        pa.ArrowException: if it is not a Parquet file.
        DamagedFileError: if it lacks a column, or would take too much memory.
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
