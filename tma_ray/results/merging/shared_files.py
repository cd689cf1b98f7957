"""Reading the rows of runs out of files that many runs share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tma_ray.decoding import INT64_MAX, DamagedFileError
from tma_ray.results.manifest import PartFile
from tma_ray.results.parquet import decode, decode_rows, unreadable_rows
from tma_ray.results.storage.store import Store

UNREADABLE: Final = (OSError, pa.ArrowException, DamagedFileError)
"""What reading a damaged file raises."""

FEW: Final = 8
"""Up to so many runs are read by their row groups alone; for more a file is read whole."""


def read_slice(store: Store, file: PartFile, columns: Sequence[str]) -> pa.Table:
    """Returns the rows of one run, reading little else. Pages are checked by their own checksums only.

    Raises:
        FileNotFoundError: the file is not there.
        DamagedFileError: it has too few rows.
        OSError, pa.ArrowException: it is not a complete Parquet file.
    """
    first = file.first or 0
    try:
        return store.read_parts(
            file.path, lambda data: decode_rows(file.table, data, first, file.rows, columns)
        )
    except IndexError as error:
        raise DamagedFileError(f"{store.where(file.path)} is damaged: {error}") from error


def read_slices(
    store: Store, files: Sequence[PartFile], columns: Sequence[str]
) -> Mapping[PartFile, pa.Table | Exception]:
    """Returns the rows of each run in one file, or why they cannot be read.

    Args:
        store: the results root.
        files: runs' rows in the same file.
        columns: which columns, in this order.
    """
    if len(files) <= FEW:
        return {file: _tried(store, file, columns) for file in files}
    try:
        rows = decode(files[0].table, files[0].read(store), columns, checked=True)
    except UNREADABLE as error:
        damage = error
    else:
        return {file: _slice(store, file, rows) for file in files}
    hit = damaged_rows(store, files[0])
    return {file: damage if is_hit(file, hit) else _tried(store, file, columns) for file in files}


def damaged_rows(store: Store, file: PartFile) -> tuple[tuple[int, int], ...]:
    """Returns first and end of rows that cannot be read of a file whose checksum is not the recorded one.

    Pages have checksums of their own, so that damage can be told from the rest. Where no page is damaged it
    is what describes them all, and no row can be trusted.
    """
    try:
        found = tuple(unreadable_rows(file.table, store.read_bytes(file.path)))
    except UNREADABLE:
        found = ()
    return found or ((0, INT64_MAX),)


def is_hit(file: PartFile, damaged: Sequence[tuple[int, int]]) -> bool:
    """Tells whether rows of a run are among those that `damaged_rows` returned."""
    first = file.first or 0
    return any(first < end and start < first + file.rows for start, end in damaged)


def _slice(store: Store, file: PartFile, rows: pa.Table) -> pa.Table | Exception:
    first = file.first or 0
    if first + file.rows > len(rows):
        return DamagedFileError(f"{store.where(file.path)} has {len(rows)} rows: too few for {file}")
    return rows.slice(first, file.rows)


def _tried(store: Store, file: PartFile, columns: Sequence[str]) -> pa.Table | Exception:
    try:
        return read_slice(store, file, columns)
    except UNREADABLE as error:
        return error


def shared_by_path(files: Iterable[PartFile]) -> dict[str, list[PartFile]]:
    """Returns those of `files` that are parts of shared ones and hold rows, by path."""
    found: dict[str, list[PartFile]] = {}
    for file in files:
        if file.first is not None and file.rows:
            found.setdefault(file.path, []).append(file)
    return found


def by_appearance(rows: pa.Table) -> pa.Table:
    """Returns `rows` with the dictionary of every column in order of appearance, without what is not used."""
    for place, field in enumerate(rows.schema):
        if pa.types.is_dictionary(field.type):
            column = rows.column(place).combine_chunks()
            used = _used(column)
            ordered = pa.DictionaryArray.from_arrays(_renumbered(column, used), column.dictionary.take(used))
            rows = rows.set_column(place, field, ordered.cast(field.type))
    return rows


def _used(column: pa.DictionaryArray) -> pa.Array:
    """Returns the indices of `column` in order of appearance, each once; most follow their like."""
    if column.null_count or not len(column):
        return pc.drop_null(pc.unique(column.indices))
    indices = column.indices.to_numpy()
    starts = np.flatnonzero(indices[1:] != indices[:-1]) + 1
    return pc.unique(pa.array(indices[np.concatenate([[0], starts])]))


def _renumbered(column: pa.DictionaryArray, used: pa.Array) -> pa.Array:
    """Returns the indices of `column` as places in `used`; a look-up, since there are tens of millions."""
    if column.null_count:
        return pc.index_in(column.indices, used).cast(column.indices.type)
    places = np.zeros(len(column.dictionary), dtype=column.indices.type.to_pandas_dtype())
    places[used.to_numpy()] = np.arange(len(used))
    return pa.array(places[column.indices.to_numpy()])
