"""Reading a results root: what its manifests list, and nothing else."""

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
T = TypeVar("T")

_Shared: TypeAlias = dict[PartFile, pa.Table | Exception]
"""Rows of runs in shared files, or why they could not be read."""

_Known: TypeAlias = dict[tuple[str, tuple[int | None, int | None]], Manifest | None]
"""Manifests by path, and by when the file was written and its bytes."""

SHOWN_RUNS: Final = 5  # number of runs that a message names
RUN_ID: Final = "run_id"  # the column that all tables of runs have

KEYS: Final = {Table.ATTEMPTS: (RUN_ID, "attempt"), Table.CELLS: (RUN_ID,)}
"""Columns by which rows of tables about runs are chosen and told apart."""

_THREADS: Final = 16  # more than cores: they wait for disks and object stores

_SETTLED_NS: Final = 5_000_000_000
"""Age of a file from which its successor would have another time, ns: some storages tell only seconds."""

_SMALL_ROWS: Final = 20_000  # rows up to which a file is decoded sooner than handed to a thread


class Results:
    """The runs of a results root as they stood when it was opened.

    A file that cannot be read, or is not what was written, is left out: a `DamagedFileWarning`
    names it and `problems` keeps the message.

    Args:
        store: the results root.
        before: an earlier look at the same root, whose manifests are taken where theirs have not changed.

    Raises:
        ResultsRootError: there is none, or one of another version.

    Attributes:
        problems: a message for each file that was left out.
    """

    def __init__(self, store: Store, before: "Results | None" = None) -> None:
        check_root(store)
        self.store = store
        self.problems: list[str] = []
        known: _Known = before._known if before is not None else {}
        now = time.time_ns()
        stamps = store.stamps(MANIFESTS)
        new = [path for path, stamp in stamps.items() if (path, stamp) not in known]
        loaded = self._map(
            lambda path: self._tried(path, lambda: load_manifest(store, path)), new, self._threads()
        )
        read = dict(zip(new, loaded, strict=True))
        found = {key: known[key] if key in known else read[key[0]] for key in stamps.items()}
        ids, problems = {PurePosixPath(path).stem for path in stamps}, len(self.problems)
        manifests = [manifest for manifest in found.values() if manifest is not None]
        for name, each in read_index(store):
            if isinstance(each, Exception):
                self._report(name, each)
            elif each.run.run_id not in ids:
                manifests.append(each)
        for path, error in lost_manifests(store, manifests, ids).items():
            self._report(path, error)
        self._warn(problems)
        self._manifests = tuple(sorted(manifests, key=lambda each: manifest_path(each.run.run_id)))
        self._places = {manifest.run.run_id: place for place, manifest in enumerate(self._manifests)}
        self._known: _Known = {
            (path, (at, size)): manifest
            for (path, (at, size)), manifest in found.items()
            if manifest is not None and at is not None and now - at > _SETTLED_NS
        }

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Return the results at a folder or URI."""
        return cls(Store.open(uri))

    def runs(self) -> tuple[Manifest, ...]:
        """Return the manifest, status and error of each run, by run id."""
        return self._manifests

    def find(self, name: str) -> Manifest:
        """Return the manifest of the run whose id is, or alone begins with, `name`.

        Raises:
            ValueError: no such run, or several.
        """
        runs = {manifest.run.run_id: manifest for manifest in self.runs()}
        meant = [name] if name in runs else [run for run in runs if run.startswith(name)]
        if len(meant) == 1:
            return runs[meant[0]]
        problem = f"{len(meant)} runs begin with" if meant else "unknown run"
        shown = (meant or list(runs))[:SHOWN_RUNS]
        rest = ", …" if len(meant or runs) > SHOWN_RUNS else ""
        raise ValueError(f"{problem} {name!r}; {self.store} has {', '.join(shown) or 'no runs'}{rest}")

    def table(
        self, table: Table, run_ids: Collection[str] | None = None, columns: Sequence[str] | None = None
    ) -> pa.Table:
        """Return the rows of a table: run after run by id, each run's in the order they were written.

        Args:
            table: name of the table.
            run_ids: ids of the runs to read, as far as they are there; all by default.
            columns: names of the columns to read, in this order; all by default.

        Raises:
            ValueError: an unknown table, or a column that it does not have.
            TypeError: `run_ids` is one text.
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
            places = sorted(self._places[run_id] for run_id in set(run_ids) if run_id in self._places)
            chosen = [self._manifests[place] for place in places]
        # Ids are known without reading them, and there are tens of millions.
        read = [name for name in names if name != RUN_ID] or names
        files = (file for manifest in chosen for file in manifest.files if file.table is table)
        slices = self._map(
            lambda sharing: read_slices(self.store, sharing, read), shared_by_path(files).values()
        )  # of files that many runs share, each read once
        shared = {file: rows for found in slices for file, rows in found.items()}
        per_run = self._map(
            lambda manifest: self._run_rows(manifest, table, read, shared),
            chosen,
            self._threads(file.rows for manifest in chosen for file in manifest.files if file.table is table),
        )
        rows = _joined(table, read, [rows for found in per_run for rows in found])
        rows = by_appearance(rows) if shared else rows
        if read == names:
            return rows
        counts = [
            (manifest.run.run_id, count)
            for manifest, found in zip(chosen, per_run, strict=True)
            if (count := sum(map(len, found)))
        ]
        repeated = np.repeat(np.arange(len(counts), dtype=np.int32), [count for _, count in counts])
        present = pa.array([run_id for run_id, _ in counts], pa.string())
        ids = pa.DictionaryArray.from_arrays(pa.array(repeated), present)
        return rows.add_column(names.index(RUN_ID), SCHEMAS[table].field(RUN_ID), ids)

    def _about_runs(self, table: Table, run_ids: Collection[str] | None, names: Sequence[str]) -> pa.Table:
        """Return at least the columns `names` of a table that no run has alone, and the keys of its rows."""
        names = [name for name in SCHEMAS[table].names if name in {*names, *KEYS.get(table, ())}]
        if table is Table.RUNS:
            rows = to_arrow(table, SCHEMAS[table], [manifest.row() for manifest in self.runs()])
        else:
            paths = self.store.files(f"{TABLES}/{table}")
            if table is Table.ATTEMPTS and run_ids is not None:  # files of the runs, and of several
                others = {table_path(table, run_id) for run_id in self._places.keys() - set(run_ids)}
                paths = tuple(path for path in paths if path not in others)
            found = self._map(
                lambda path: self._tried(path, lambda: decode(table, self.store.read_bytes(path), names)),
                paths,
                self._threads(),
            )
            rows = _joined(table, names, [part for part in found if part is not None])
        if table is Table.ATTEMPTS:  # while files are being merged some are there twice
            keys = list(zip(rows["run_id"].to_pylist(), rows["attempt"].to_pylist(), strict=True))
            places = {key: place for place, key in enumerate(keys)}
            order = [places[key] for key in sorted(places)]
            rows = rows if order == list(range(len(keys))) else by_appearance(rows.take(order))
        if run_ids is None:
            return rows
        ids = rows["run_id"].combine_chunks().cast(pa.string())
        wanted = pc.is_in(ids, pa.array(list(run_ids), pa.string()))
        return rows if pc.all(wanted, min_count=0).as_py() else rows.filter(wanted)

    def _run_rows(
        self, manifest: Manifest, table: Table, columns: Sequence[str], shared: _Shared
    ) -> list[pa.Table]:
        files = [file for file in manifest.files if file.table is table]
        found = []
        for file in files:
            try:
                if file.first is None:
                    rows = decode(file.table, file.read(self.store), columns, file.rows, checked=True)
                elif not file.rows:
                    rows = SCHEMAS[file.table].empty_table().select(columns)
                else:
                    rows = shared[file] if file in shared else read_slice(self.store, file, columns)
                if isinstance(rows, Exception):
                    raise rows
                found.append(rows)
            except UNREADABLE as error:
                if isinstance(error, FileNotFoundError):
                    # Parts go when a run ends, and files when they are merged.
                    run_id = manifest.run.run_id
                    fresh = self._tried(manifest_path(run_id), lambda: Manifest.load(self.store, run_id))  # noqa: B023
                    if fresh is not None and fresh.files != manifest.files:
                        return self._run_rows(fresh, table, columns, {})
                self._report(file.path, error)
        return found

    def _tried(self, path: str, read: Callable[[], T]) -> T | None:
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
        """Return the number of threads that read files of so many rows; one for small local files."""
        return _THREADS if self.store.is_object_store or max(rows, default=0) > _SMALL_ROWS else 1

    def _map(self, function: Callable[[S], T], items: Iterable[S], threads: int = _THREADS) -> list[T]:
        """Return the results in the order of `items`, computed in threads; warns of new problems."""
        known = len(self.problems)
        if threads == 1:
            found = list(map(function, items))
        else:
            with ThreadPoolExecutor(threads) as executor:
                found = list(executor.map(function, items))
        self._warn(known)
        return found

    def _warn(self, known: int) -> None:
        """Warn of the problems after the first `known` ones."""
        for problem in self.problems[known:]:
            warnings.warn(problem, DamagedFileWarning, stacklevel=5)


def _joined(table: Table, columns: Sequence[str], found: Sequence[pa.Table]) -> pa.Table:
    empty = SCHEMAS[table].empty_table().select(columns)
    return pa.concat_tables([empty, *found]).unify_dictionaries()
