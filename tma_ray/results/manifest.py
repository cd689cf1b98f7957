"""Manifests, which list the published files of runs, and the reading of these files."""

import gzip
import hashlib
import io
import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tma_ray.results.layout import INDEX_FILE, TABLES, check_path, manifest_path, staging_folder, table_path
from tma_ray.results.parquet import decode, decode_rows, unreadable_rows
from tma_ray.results.records import RunRecord, RunStatus, check_spec, mastery_threshold
from tma_ray.results.schema import Table
from tma_ray.results.storage import Store
from tma_ray.support.decoding import (
    INT64_MAX,
    MOST_FILE_BYTES,
    DamagedFileError,
    Natural,
    Sha256,
    SmallNatural,
    check_size,
    decode_json,
)

MOST_RUN_ROWS: Final = 50_000_000  # largest number of rows of a run in a table; a larger one indicates damage


def read_checked(store: Store, path: str, sha256: str) -> bytes:
    """Return the content of a file, or raise a DamagedFileError if its checksum differs."""
    data = store.read_bytes(path)
    if hashlib.sha256(data).hexdigest() != sha256:
        raise DamagedFileError(f"{store.where(path)} is damaged: its sha256 is not the recorded one")
    return data


@dataclass(frozen=True)
class PartFile:
    """A run's Parquet file, or its rows in a shared file.

    Attributes:
        path: path of the file, relative to the results root.
        rows: number of rows of the run.
        sha256: checksum of the file, hexadecimal.
        first: first row of the run in a shared file, None for a file of the run alone.
    """

    table: Table
    path: str
    rows: Natural
    sha256: Sha256
    first: Natural | None = None

    def __post_init__(self) -> None:
        check_path(self.path)

    @classmethod
    def write(cls, store: Store, path: str, table: Table, rows: int, data: bytes) -> Self:
        """Write a table's encoded rows to a file, and return the instance that describes the file."""
        store.write_bytes(path, data)
        return cls(table, path, rows, hashlib.sha256(data).hexdigest())

    def read(self, store: Store) -> bytes:
        """Return the content of the file after verifying its checksum."""
        return read_checked(store, self.path, self.sha256)

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        value = asdict(self)
        return value if self.first is not None else {k: v for k, v in value.items() if k != "first"}


@dataclass(frozen=True)
class Manifest:
    """Published files and state of a run.

    Attributes:
        run: description of the run.
        attempt: accepted attempt, which makes older ones stale.
        files: ordered parts of a running run, or one canonical file per data table of a finished run.
        error: reason of a failure.
    """

    run: RunRecord
    status: RunStatus
    attempt: SmallNatural
    files: tuple[PartFile, ...] = ()
    error: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return asdict(self) | {"files": [file.to_json() for file in self.files]}

    def to_bytes(self) -> bytes:
        """Return the content of the manifest file."""
        return json.dumps(self.to_json(), indent=1).encode()

    @staticmethod
    def load(store: Store, run_id: str) -> "Manifest":
        """Return the manifest of a run, read from its own file or the index."""
        try:
            return load_manifest(store, manifest_path(run_id))
        except FileNotFoundError:
            for _, manifest in read_index(store, f'"run_id": "{run_id}"'):
                if isinstance(manifest, Exception):
                    raise manifest from None
                if manifest.run.run_id == run_id:
                    return manifest
            raise

    def check(self, run_id: str) -> None:
        """Raise a ValueError if the manifest is implausible, or any part of it is not about run `run_id`."""
        if self.run.run_id != run_id:
            raise ValueError(f"it is about another run, {self.run.run_id!r}")
        check_spec(self.run)
        for file in self.files:
            staged = file.path.startswith(f"{staging_folder(run_id)}/")
            shared = file.first is not None and file.path.startswith(f"{TABLES}/{file.table}/")
            if not (staged or shared or file.path == table_path(file.table, run_id)):
                raise ValueError(f"it lists {file.path}, which does not belong to run {run_id}")
        largest = max(self.files, key=lambda file: file.rows, default=None)
        if largest is not None and largest.rows > MOST_RUN_ROWS:
            raise ValueError(f"it lists {largest.rows:,} rows in {largest.path}, more than any run has")
        listed = [(file.path, file.first) for file in self.files]
        if len(set(listed)) < len(listed):
            raise ValueError("it lists a file twice")

    def row(self) -> dict[str, Any]:
        """Return the row of the run in the table of runs."""
        added = {"error": self.error, "mastery_threshold": mastery_threshold(self.run)}
        return {**vars(self.run), "status": self.status.value, **added}


def load_manifest(store: Store, path: str) -> Manifest:
    """Return the manifest at `path`, or raise a DamagedFileError if it is invalid."""
    manifest = store.read_json(path, Manifest)
    try:
        manifest.check(path.rpartition("/")[2].removesuffix(".json"))
    except ValueError as error:
        raise DamagedFileError(f"{store.where(path)} is damaged: {error}") from error
    return manifest


def write_index(store: Store, manifests: Iterable[Manifest]) -> None:
    """Write the manifests of a complete root to one file, as one JSON object per line, sorted by run id."""
    ordered = sorted(manifests, key=lambda manifest: manifest.run.run_id)
    lines = (json.dumps(manifest.to_json(), ensure_ascii=False) for manifest in ordered)
    text = "".join(f"{line}\n" for line in lines)
    store.write_bytes(INDEX_FILE, gzip.compress(text.encode(), mtime=0))


def read_index(store: Store, text: str = "") -> Iterator[tuple[str, Manifest | Exception]]:
    """Yield the name and manifest (an error if damaged) of each index line that contains `text`."""
    if not store.holds(INDEX_FILE):  # usually missing, and `status` checks it repeatedly
        return
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(store.read_bytes(INDEX_FILE))) as file:
            content = file.read(MOST_FILE_BYTES + 1)
        check_size(store.where(INDEX_FILE), len(content), MOST_FILE_BYTES)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        yield INDEX_FILE, DamagedFileError(f"{store.where(INDEX_FILE)} is damaged: {error}")
        return
    except (OSError, DamagedFileError) as error:
        yield INDEX_FILE, error
        return
    for number, line in enumerate(content.splitlines(), start=1):
        if text.encode() in line:
            name = f"{INDEX_FILE} line {number}"
            try:
                manifest = decode_json(line, Manifest, store.where(name))
                manifest.check(manifest.run.run_id)
            except DamagedFileError as error:
                yield name, error
            except ValueError as error:
                yield name, DamagedFileError(f"{store.where(name)} is damaged: {error}")
            else:
                yield name, manifest


UNREADABLE: Final = (OSError, pa.ArrowException, DamagedFileError)  # errors raised on reading a damaged file
MOST_SLICES: Final = 8  # largest number of runs to read by row group; for more, a shared file is read whole


def read_slice(store: Store, file: PartFile, columns: Sequence[str]) -> pa.Table:
    """Return the rows of one run, reading only its row groups and verifying their page checksums."""
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
    """Return the rows of each run in one shared file, or the error raised on reading them."""
    if len(files) <= MOST_SLICES:
        return {file: _tried(store, file, columns) for file in files}
    try:
        rows = decode(files[0].table, files[0].read(store), columns, checked=True)
    except UNREADABLE as error:
        damage = error
    else:
        return {
            file: rows.slice(file.first or 0, file.rows)
            if (file.first or 0) + file.rows <= len(rows)
            else DamagedFileError(f"{store.where(file.path)} has {len(rows)} rows: too few for {file}")
            for file in files
        }
    hit = damaged_rows(store, files[0])
    return {file: damage if overlaps(file, hit) else _tried(store, file, columns) for file in files}


def damaged_rows(store: Store, file: PartFile) -> tuple[tuple[int, int], ...]:
    """Return the ranges of unreadable rows in a damaged file; all rows if its page checksums match."""
    try:
        ranges = tuple(unreadable_rows(file.table, store.read_bytes(file.path)))
    except UNREADABLE:
        ranges = ()
    return ranges or ((0, INT64_MAX),)  # all rows, since the damage is outside of the pages


def overlaps(file: PartFile, damaged: Sequence[tuple[int, int]]) -> bool:
    """Return True if any rows of `file` are in the ranges returned by `damaged_rows`."""
    first = file.first or 0
    return any(first < end and start < first + file.rows for start, end in damaged)


def _tried(store: Store, file: PartFile, columns: Sequence[str]) -> pa.Table | Exception:
    try:
        return read_slice(store, file, columns)
    except UNREADABLE as error:
        return error


def shared_by_path(files: Iterable[PartFile]) -> dict[str, list[PartFile]]:
    """Return the nonempty slices of shared files among `files`, by path."""
    slices: dict[str, list[PartFile]] = {}
    for file in files:
        if file.first is not None and file.rows:
            slices.setdefault(file.path, []).append(file)
    return slices


def by_appearance(rows: pa.Table) -> pa.Table:
    """Return `rows` with each dictionary reduced to the values used, in order of first appearance."""
    for number, field in enumerate(rows.schema):
        if pa.types.is_dictionary(field.type):
            column = rows.column(number).combine_chunks()
            if column.null_count or not len(column):
                used = pc.drop_null(pc.unique(column.indices))
                renumbered = pc.index_in(column.indices, used).cast(column.indices.type)
            else:  # fast for tens of millions of indices in long runs of equal values
                indices = column.indices.to_numpy()
                starts = np.flatnonzero(indices[1:] != indices[:-1]) + 1
                used = pc.unique(pa.array(indices[np.concatenate([[0], starts])]))
                numbers = np.zeros(len(column.dictionary), dtype=indices.dtype)
                numbers[used.to_numpy()] = np.arange(len(used))
                renumbered = pa.array(numbers[indices])
            ordered = pa.DictionaryArray.from_arrays(renumbered, column.dictionary.take(used))
            rows = rows.set_column(number, field, ordered.cast(field.type))
    return rows
