"""Reader of a results root, based on its manifests."""

import time
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath
from typing import Final, Self, TypeAlias, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tma_ray.results.layout import MANIFESTS, TABLES, check_root, manifest_path, table_path
from tma_ray.results.manifest import (
    UNREADABLE,
    Manifest,
    PartFile,
    by_appearance,
    load_manifest,
    read_index,
    read_slice,
    read_slices,
    shared_by_path,
)
from tma_ray.results.parquet import decode
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table, to_arrow
from tma_ray.results.storage import Store
from tma_ray.results.verification import damage_reason, lost_manifests
from tma_ray.support.decoding import DamagedFileWarning
from tma_ray.support.validation import check_known, check_sequence

S = TypeVar("S")
ReadT = TypeVar("ReadT")

_Shared: TypeAlias = dict[PartFile, pa.Table | Exception]
"""Rows of runs in shared files, or the error raised on reading them."""

_Cache: TypeAlias = dict[tuple[str, tuple[int | None, int | None]], Manifest | None]
"""Manifests by path and stamp of their files."""

SHOWN_RUNS: Final = 5  # largest number of runs that a message names
RUN_ID: Final = "run_id"

KEYS: Final = {Table.ATTEMPTS: (RUN_ID, "attempt"), Table.CELLS: (RUN_ID,)}
"""Key columns of tables about runs."""

_THREADS: Final = 16  # may exceed the number of cores, since threads mostly wait for disks or object stores
_SETTLED_NS: Final = 5_000_000_000  # age from which any rewrite of a file changes its modification time, ns
_SMALL_ROWS: Final = 20_000  # files with fewer rows take less time to decode than to pass to a thread


class Results:
    """Snapshot of the runs in a results root.

    Unreadable and damaged files are left out with a `DamagedFileWarning`.

    Args:
        store: store of the results root.
        before: earlier snapshot of the same root, whose unchanged manifests are reused.

    Raises:
        ResultsRootError: if it is not a results root, or of another version.

    Attributes:
        problems: messages about the files left out.
    """

    def __init__(self, store: Store, before: "Results | None" = None) -> None:
        check_root(store)
        self.store = store
        self.problems: list[str] = []
        cache: _Cache = before._cache if before is not None else {}
        now = time.time_ns()
        stamps = store.stamps(MANIFESTS)
        new = [path for path, stamp in stamps.items() if (path, stamp) not in cache]
        loaded = self._map(
            lambda path: self._tried(path, lambda: load_manifest(store, path)), new, self._threads()
        )
        read = dict(zip(new, loaded, strict=True))
        listed = {key: cache[key] if key in cache else read[key[0]] for key in stamps.items()}
        ids, problems = {PurePosixPath(path).stem for path in stamps}, len(self.problems)
        manifests = [manifest for manifest in listed.values() if manifest is not None]
        for name, entry in read_index(store):
            if isinstance(entry, Exception):
                self._report(name, entry)
            elif entry.run.run_id not in ids:
                manifests.append(entry)
        for path, error in lost_manifests(store, manifests, ids).items():
            self._report(path, error)
        self._warn(problems)
        self._manifests = tuple(sorted(manifests, key=lambda run: manifest_path(run.run.run_id)))
        self._indices = {manifest.run.run_id: index for index, manifest in enumerate(self._manifests)}
        self._cache: _Cache = {
            (path, (time_ns, size)): manifest
            for (path, (time_ns, size)), manifest in listed.items()
            if manifest is not None and time_ns is not None and now - time_ns > _SETTLED_NS
        }

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Open the results root at a folder or URI."""
        return cls(Store.open(uri))

    def runs(self) -> tuple[Manifest, ...]:
        """Return the manifests of all runs, sorted by run id."""
        return self._manifests

    def find(self, name: str) -> Manifest:
        """Return the manifest of the run with `name` as its id or as an unambiguous prefix of its id.

        Raises:
            ValueError: if no run matches, or several do.
        """
        runs = {manifest.run.run_id: manifest for manifest in self.runs()}
        matches = [name] if name in runs else [run for run in runs if run.startswith(name)]
        if len(matches) == 1:
            return runs[matches[0]]
        problem = f"{len(matches)} runs begin with" if matches else "unknown run"
        shown = (matches or list(runs))[:SHOWN_RUNS]
        rest = ", …" if len(matches or runs) > SHOWN_RUNS else ""
        raise ValueError(f"{problem} {name!r}; {self.store} has {', '.join(shown) or 'no runs'}{rest}")

    def table(
        self, table: Table, run_ids: Collection[str] | None = None, columns: Sequence[str] | None = None
    ) -> pa.Table:
        """Return the rows of a table, sorted by run id and then in the order of writing.

        Args:
            table: name of the table.
            run_ids: ids of the runs to read, ignoring missing ones; all by default.
            columns: columns to read, in this order; all by default.

        Raises:
            ValueError: if the table or a column is unknown.
            TypeError: if `run_ids` is a single text.
        """
        check_known("table", table, list(Table), "there are")
        check_sequence("run_ids", () if run_ids is None else run_ids)
        names = SCHEMAS[table].names if columns is None else list(columns)
        unknown = [name for name in names if name not in SCHEMAS[table].names]
        if unknown:
            raise ValueError(
                f"{table} has no column {unknown[0]!r}; it has {', '.join(SCHEMAS[table].names)}"
            )
        if table not in DATA_TABLES:
            return self._about_runs(table, run_ids, names).select(names)
        chosen: Sequence[Manifest] = self._manifests
        if run_ids is not None:
            indices = sorted(self._indices[run_id] for run_id in set(run_ids) if run_id in self._indices)
            chosen = [self._manifests[index] for index in indices]
        # ids are filled in below, since there may be tens of millions to read
        read = [name for name in names if name != RUN_ID] or names
        files = (file for manifest in chosen for file in manifest.files if file.table is table)
        slices = self._map(
            lambda sharing: read_slices(self.store, sharing, read), shared_by_path(files).values()
        )  # reads each shared file once
        shared = {file: rows for file_slices in slices for file, rows in file_slices.items()}
        per_run = self._map(
            lambda manifest: self._run_rows(manifest, table, read, shared),
            chosen,
            self._threads(file.rows for manifest in chosen for file in manifest.files if file.table is table),
        )
        rows = _joined(table, read, [part for parts in per_run for part in parts])
        rows = by_appearance(rows) if shared else rows
        if read == names:
            return rows
        counts = [
            (manifest.run.run_id, count)
            for manifest, parts in zip(chosen, per_run, strict=True)
            if (count := sum(map(len, parts)))
        ]
        repeated = np.repeat(np.arange(len(counts), dtype=np.int32), [count for _, count in counts])
        present = pa.array([run_id for run_id, _ in counts], pa.string())
        ids = pa.DictionaryArray.from_arrays(pa.array(repeated), present)
        return rows.add_column(names.index(RUN_ID), SCHEMAS[table].field(RUN_ID), ids)

    def _about_runs(self, table: Table, run_ids: Collection[str] | None, names: Sequence[str]) -> pa.Table:
        """Return a table about runs, with at least the columns `names` and the key columns."""
        names = [name for name in SCHEMAS[table].names if name in {*names, *KEYS.get(table, ())}]
        if table is Table.RUNS:
            rows = to_arrow(table, SCHEMAS[table], [manifest.row() for manifest in self.runs()])
        else:
            paths = self.store.files(f"{TABLES}/{table}")
            if table is Table.ATTEMPTS and run_ids is not None:  # skip files of other runs
                others = {table_path(table, run_id) for run_id in self._indices.keys() - set(run_ids)}
                paths = tuple(path for path in paths if path not in others)
            parts = self._map(
                lambda path: self._tried(path, lambda: decode(table, self.store.read_bytes(path), names)),
                paths,
                self._threads(),
            )
            rows = _joined(table, names, [part for part in parts if part is not None])
        if table is Table.ATTEMPTS:  # duplicates exist while files are merged
            keys = list(zip(rows["run_id"].to_pylist(), rows["attempt"].to_pylist(), strict=True))
            indices = {key: index for index, key in enumerate(keys)}
            order = [indices[key] for key in sorted(indices)]
            rows = rows if order == list(range(len(keys))) else by_appearance(rows.take(order))
        if run_ids is None:
            return rows
        ids = rows["run_id"].combine_chunks().cast(pa.string())
        mask = pc.is_in(ids, pa.array(list(run_ids), pa.string()))
        return rows if pc.all(mask, min_count=0).as_py() else rows.filter(mask)

    def _run_rows(
        self, manifest: Manifest, table: Table, columns: Sequence[str], shared: _Shared
    ) -> list[pa.Table]:
        parts = []
        for file in (file for file in manifest.files if file.table is table):
            try:
                if file.first is None:
                    rows = decode(file.table, file.read(self.store), columns, file.rows, checked=True)
                elif not file.rows:
                    rows = SCHEMAS[file.table].empty_table().select(columns)
                else:
                    rows = shared[file] if file in shared else read_slice(self.store, file, columns)
                if isinstance(rows, Exception):
                    raise rows
                parts.append(rows)
            except UNREADABLE as error:
                if isinstance(error, FileNotFoundError):
                    # parts are deleted when a run ends, and files when they are merged
                    run_id = manifest.run.run_id
                    fresh = self._tried(manifest_path(run_id), lambda: Manifest.load(self.store, run_id))  # noqa: B023
                    if fresh is not None and fresh.files != manifest.files:
                        return self._run_rows(fresh, table, columns, {})
                self._report(file.path, error)
        return parts

    def _tried(self, path: str, read: Callable[[], ReadT]) -> ReadT | None:
        try:
            return read()
        except UNREADABLE as error:
            self._report(path, error)
            return None

    def _report(self, path: str, error: Exception) -> None:
        where = self.store.where(path)
        problem = f"{where} was left out: {damage_reason(error, where)}"
        if problem not in self.problems:
            self.problems.append(problem)

    def _threads(self, rows: Iterable[int] = ()) -> int:
        """Return the number of threads to read files with `rows` rows; 1 for small local files."""
        return _THREADS if self.store.is_object_store or max(rows, default=0) > _SMALL_ROWS else 1

    def _map(
        self, function: Callable[[S], ReadT], items: Iterable[S], threads: int = _THREADS
    ) -> list[ReadT]:
        """Apply `function` to `items` in threads, warn about new problems, and return results in order."""
        before = len(self.problems)
        if threads == 1:
            results = list(map(function, items))
        else:
            with ThreadPoolExecutor(threads) as executor:
                results = list(executor.map(function, items))
        self._warn(before)
        return results

    def _warn(self, start: int) -> None:
        """Issue warnings for the problems from index `start` on."""
        for problem in self.problems[start:]:
            warnings.warn(problem, DamagedFileWarning, stacklevel=5)


def _joined(table: Table, columns: Sequence[str], parts: Sequence[pa.Table]) -> pa.Table:
    empty = SCHEMAS[table].empty_table().select(columns)
    return pa.concat_tables([empty, *parts]).unify_dictionaries()
