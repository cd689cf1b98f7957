"""Memory that columns of a Parquet file take when they are read, by the headers of its pages.

What the end of a file says of its columns is not believed: decompression and decoding follow the pages alone.
A text that is stored once, in a dictionary or as the beginning of others, is read as often as rows name it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Any, Final, TypeAlias

import pyarrow.parquet as pq

from tma_ray.decoding import DamagedFileError

_Fields: TypeAlias = dict[int, Any]
"""Numbers and structures of Thrift by the number of their field."""

HEADER_BYTES: Final = (512, 1 << 16)
"""Bytes that are read to find the header of a page: at first, and if it is longer."""

PAGE_BYTES: Final = 1024
"""Bytes that a page counts besides its content: many empty ones take time."""

_VALUE_BYTES: Final = 8
"""Size of a number, or of the place of a text."""

_NUMBERS: Final = ("BOOLEAN", "INT32", "INT64", "FLOAT", "DOUBLE")
_PLAIN, _LENGTHS_APART, _BY_DICTIONARY = 0, 6, (2, 8)  # encodings
_SIZE, _PACKED_SIZE, _DATA, _DICTIONARY, _DATA_2 = 2, 3, 5, 7, 8  # fields of the header of a page
_BOOLEANS, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _STRUCTURE = (1, 2), 3, (4, 5, 6), 7, 8, 12  # kinds of fields


def unpacked_sizes(
    file: pq.ParquetFile, source: Any, groups: Iterable[int], columns: Collection[str], kept: Collection[str]
) -> Iterator[int]:
    """Yields bounds of the bytes that pages of some columns take in memory, one by one.

    Args:
        file: the opened file.
        source: the same file, with `read_at`.
        groups: row groups that are to be read.
        columns: columns that are to be read.
        kept: those of texts that are read as dictionaries, in which every text stays one.

    Raises:
        DamagedFileError: something else lies where a page should be.
    """
    for group in map(file.metadata.row_group, groups):
        for chunk in map(group.column, range(group.num_columns)):
            if not chunk.num_values or chunk.path_in_schema.partition(".")[0] not in columns:
                continue  # of a column without values no page is read
            stays = chunk.physical_type == "BYTE_ARRAY" and chunk.path_in_schema in kept
            largest = 0
            for page in _pages(source, chunk):
                if _DICTIONARY in page:
                    largest = 0 if stays else page[_SIZE]
                is_number = chunk.physical_type in _NUMBERS
                yield PAGE_BYTES + (_numbers(page) if is_number else _texts(page, largest))


def _numbers(page: _Fields) -> int:
    return int(page[_SIZE] + _VALUE_BYTES * _count(page))


def _texts(page: _Fields, largest: int) -> int:
    """Returns the bytes of texts, of which those in the dictionary have `largest` bytes or fewer."""
    encoding = page.get(_DATA_2, {}).get(4, page.get(_DATA, {}).get(2, _PLAIN))
    if encoding in (_PLAIN, _LENGTHS_APART):
        return _numbers(page)
    return int(_count(page) * (_VALUE_BYTES + (largest if encoding in _BY_DICTIONARY else page[_SIZE])))


def _count(page: _Fields) -> int:
    content = page.get(_DATA) or page.get(_DATA_2) or page.get(_DICTIONARY) or {}
    return int(content.get(1, 0))


def _pages(source: Any, chunk: Any) -> Iterator[_Fields]:
    """Yields the headers of the pages of a column."""
    at = chunk.data_page_offset
    if chunk.has_dictionary_page:
        at = min(at, chunk.dictionary_page_offset or at)
    end = at + chunk.total_compressed_size
    while at < end:
        page, size = _header(source, at)
        if min(page.get(_SIZE, -1), page.get(_PACKED_SIZE, -1), _count(page)) < 0:
            raise DamagedFileError(f"a page at {at:,} tells no size")
        yield page
        at += size + page[_PACKED_SIZE]


def _header(source: Any, at: int) -> tuple[_Fields, int]:
    """Returns the header of a page and how many bytes it has."""
    for size in HEADER_BYTES:
        try:
            return _structure(source.read_at(size, at), 0)
        except (IndexError, RecursionError):
            continue
    raise DamagedFileError(f"no page begins at {at:,}")


def _structure(data: bytes, at: int) -> tuple[_Fields, int]:
    """Returns the numbers and structures in a structure of Thrift's compact protocol, and where it ends."""
    fields: _Fields = {}
    number = 0
    while data[at]:
        kind, step = data[at] & 15, data[at] >> 4
        at += 1
        if step:
            number += step
        else:
            number, at = _integer(data, at)
        if kind == _STRUCTURE:
            fields[number], at = _structure(data, at)
        elif kind in _INTEGERS:
            fields[number], at = _integer(data, at)
        elif kind == _BINARY:
            size, at = _unsigned(data, at)
            at += size
        elif kind in (_BYTE, _DOUBLE):
            at += 1 if kind == _BYTE else 8
        elif kind not in _BOOLEANS:
            raise DamagedFileError(f"a page's header has a field of kind {kind}, which none has")
    return fields, at + 1


def _integer(data: bytes, at: int) -> tuple[int, int]:
    value, at = _unsigned(data, at)
    return (value >> 1) ^ -(value & 1), at


def _unsigned(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 127) << shift
        shift += 7
        at += 1
        if data[at - 1] < 128:
            return value, at
