"""Tables of many runs in one file each: packed, copied, compacted, added as shards."""

import os
import re
import socket
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from safetensors.numpy import load as parse_tensors
from safetensors.numpy import save as serialise_tensors

import tma_ray.results.layout as layout  # noqa: PLR0402 - this module is imported by the package
from tma_ray.results.inputs import kept_files
from tma_ray.results.lease import Lease
from tma_ray.results.manifest import UNREADABLE, Manifest, PartFile, write_index
from tma_ray.results.parquet import decode, decode_rows, encode, encode_together, same_rows
from tma_ray.results.reader import Results
from tma_ray.results.records import RunRecord, RunStatus, mastery_threshold
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table, to_arrow
from tma_ray.results.storage import ResultsRootError, Store
from tma_ray.results.verification import Inspector
from tma_ray.support.decoding import DamagedFileError, DamagedFileWarning

SINGLE_RUNS = "single_runs"  # name of the files of runs that belong to no experiment


@dataclass(frozen=True)
class CopyOptions:
    """CopyOptions of a copy of a root.

    Attributes:
        tables: data tables that are copied.
        unfinished: True to copy runs that are not done.
        policies: True to copy final policies.
        hosts: True to keep the names of machines in the table of attempts.
        runs: ids of the runs that are copied; None for all.
        rounded: True to round returns of evaluations and tasks of curricula to `SIGNIFICANT_BITS`, and to
            write the weights of policies as float16.
    """

    tables: tuple[Table, ...] = DATA_TABLES
    unfinished: bool = True
    policies: bool = True
    hosts: bool = True
    runs: frozenset[str] | None = None
    rounded: bool = False


WHOLE: Final = CopyOptions()
"""All that a root says of its runs."""

LEAN: Final = CopyOptions(
    (Table.EVALUATIONS, Table.TRAINING, Table.CURRICULUM),
    unfinished=False,
    policies=False,
    hosts=False,
    rounded=True,
)
"""Some 10 kB a run: neither episodes, logs of teachers and policies, nor names of machines; rounded."""

SIGNIFICANT_BITS: Final = {Table.EVALUATIONS: ("episodic_return", 24), Table.CURRICULUM: ("task", 12)}
"""Columns that are rounded, and the significant bits of their values, relative errors of 6e-8 and 2.4e-4: the
other bits are noise, which nothing compresses."""


def experiments_of(results: Results) -> dict[str, str]:
    """Return the experiment of each run by id, as file names have it; of several the first by name."""
    cells = results.table(Table.CELLS, columns=["experiment", "run_id"]).to_pylist()
    found = {
        cell["run_id"]: cell["experiment"]
        for cell in sorted(cells, key=lambda c: c["experiment"], reverse=True)
    }
    ids = (manifest.run.run_id for manifest in results.runs())
    return {
        run_id: re.sub(r"[^0-9a-zA-Z_-]", "_", found.get(run_id, SINGLE_RUNS)) or SINGLE_RUNS
        for run_id in ids
    }


def grouped(manifests: Sequence[Manifest], experiments: Mapping[str, str]) -> dict[str, list[Manifest]]:
    """Return `manifests` by experiment, each group by run id."""
    groups: dict[str, list[Manifest]] = {}
    for manifest in sorted(manifests, key=lambda manifest: manifest.run.run_id):
        groups.setdefault(experiments[manifest.run.run_id], []).append(manifest)
    return dict(sorted(groups.items()))


def pack(
    results: Results,
    manifests: Sequence[Manifest],
    target: Store,
    name: str,
    tick: Callable[[], None],
    options: CopyOptions = WHOLE,
) -> list[Manifest]:
    """Write one file per table with all rows of some runs; returns manifests that lead to them.

    The rows come run after run, each run's as they were written: in order of steps, and rounded if `contents`
    says so. Nothing refers to the files yet when it returns; they have been read back and compared with what
    they were made of.

    Args:
        results: the root that the runs are read from.
        manifests: manifests of these runs, by run id.
        target: the root to write to, perhaps the same.
        name: name of the files; none of that name may exist.
        tick: called now and then, as long work needs signs of life.
        options: tables and files to write.

    Raises:
        DamagedFileError: rows cannot be read, or were not written as they are.
    """
    slices: dict[str, list[PartFile]] = {manifest.run.run_id: [] for manifest in manifests}
    for table in options.tables:
        for run_id, file in _pack_table(results, manifests, target, (table, name), tick, options):
            slices[run_id].append(file)
    for table in (Table.RUNS, Table.ATTEMPTS):
        rows, path = results.table(table, list(slices)), layout.table_path(table, name)
        if table is Table.ATTEMPTS and not options.hosts:
            place = rows.schema.get_field_index("host")
            field = rows.schema.field(place)
            empty = pa.array([""] * len(rows), pa.string()).dictionary_encode().cast(field.type)
            rows = rows.set_column(place, field, empty)
        PartFile.write(target, path, table, len(rows), encode(table, rows)).read(target)
    return [replace(manifest, files=tuple(slices[manifest.run.run_id])) for manifest in manifests]


def _rows_of(results: Results, table: Table, run: RunRecord, rounded: bool) -> pa.Table:
    """Return the rows of one run; a DamagedFileError if some cannot be read."""
    before = len(results.problems)
    rows = results.table(table, [run.run_id])
    if len(results.problems) > before:
        raise DamagedFileError(f"nothing was merged: {results.problems[before]}")
    return _rounded(rows, table, run) if rounded and table in SIGNIFICANT_BITS else rows


def _rounded(rows: pa.Table, table: Table, run: RunRecord) -> pa.Table:
    """Return `rows` with fewer significant bits; no return crosses the threshold of mastery."""
    column, bits = SIGNIFICANT_BITS[table]
    place = rows.schema.get_field_index(column)
    values = rows[column].combine_chunks()
    exact = (values.values if table is Table.CURRICULUM else values).to_numpy()
    significand, exponent = np.frexp(exact)
    fewer = np.ldexp(np.round(np.ldexp(significand, bits)), exponent - bits)
    if table is Table.CURRICULUM:
        fewer = pa.ListArray.from_arrays(values.offsets, fewer).cast(values.type)
    else:
        threshold = mastery_threshold(run)
        fewer = pa.array(np.where((fewer > threshold) == (exact > threshold), fewer, exact))
    return rows.set_column(place, rows.schema.field(place), fewer)


def _pack_table(
    results: Results,
    manifests: Sequence[Manifest],
    target: Store,
    place: tuple[Table, str],
    tick: Callable[[], None],
    options: CopyOptions,
) -> Iterator[tuple[str, PartFile]]:
    table, name = place
    counts: dict[str, int] = {}

    def parts() -> Iterator[pa.Table]:
        for manifest in manifests:
            tick()
            rows = _rows_of(results, table, manifest.run, options.rounded)
            counts[manifest.run.run_id] = len(rows)
            yield rows

    data, path = encode_together(table, parts()), layout.table_path(table, name)
    if target.exists(path):
        raise DamagedFileError(f"{target.where(path)} is there already; nothing was merged")
    written = PartFile.write(target, path, table, sum(counts.values()), data)
    stored, first = pa.BufferReader(written.read(target)), 0
    for manifest in manifests:
        tick()
        run_id = manifest.run.run_id
        expected = _rows_of(results, table, manifest.run, options.rounded)
        found = (
            decode_rows(table, stored, first, counts[run_id], SCHEMAS[table].names)
            if counts[run_id]
            else expected
        )
        if not same_rows(table, found, expected):
            raise DamagedFileError(
                f"{target.where(path)} does not hold what run {run_id} wrote; nothing was merged"
            )
        yield run_id, replace(written, rows=counts[run_id], first=first)
        first += counts[run_id]


JOURNAL: Final = "compacting.json"
"""Name of the list of files without use: replaced ones, or new ones of an interrupted compaction."""

_MERGED: Final = re.compile(rf"{layout.TABLES}/[^/]+/[^/]+\.parquet")


@dataclass(frozen=True)
class Journal:
    """Files to delete in the end: those that no manifest lists, and those that were replaced."""

    unless_used: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for path in (*self.unless_used, *self.replaced):
            if not _MERGED.fullmatch(layout.check_path(path)):
                raise ValueError(
                    f"path {path!r}: expected a file of a table, as in {layout.TABLES}/runs/NAME.parquet"
                )

    @classmethod
    def load(cls, store: Store) -> "Journal":
        """Return the journal of a root; an empty one if there is none, or one that cannot be read."""
        try:
            return store.read_json(JOURNAL, cls)
        except FileNotFoundError:
            return cls()
        except DamagedFileError as error:  # what it listed stays, and no reader looks at it
            warnings.warn(str(error), DamagedFileWarning, stacklevel=2)
            return cls()

    def write(self, store: Store) -> None:
        """Replace the journal of a root by this one."""
        store.write_json(JOURNAL, Journal(tuple(sorted(set(self.unless_used))), self.replaced))


def clean(store: Store) -> None:
    """Delete what the journal lists and no manifest needs.

    While a manifest cannot be read, what it may list stays: all but files of runs whose manifests can.
    """
    if not store.exists(JOURNAL):
        return
    journal, results = Journal.load(store), Results(store)
    used = {file.path for manifest in results.runs() for file in manifest.files}
    known = {manifest.run.run_id for manifest in results.runs()}
    unused = [path for path in journal.unless_used if path not in used]
    doubtful = [
        path
        for path in unused
        if results.problems and known.isdisjoint((*PurePosixPath(path).parts, PurePosixPath(path).stem))
    ]
    for path in (*(path for path in unused if path not in doubtful), *journal.replaced):
        store.delete(path)
    if doubtful:
        Journal(tuple(doubtful)).write(store)
    else:
        store.delete(JOURNAL)


POLICY_FILES: Final = (".json", ".safetensors")
"""Endings of the files of policies that are copied: nothing that runs when it is read."""


@dataclass(frozen=True)
class Copy:
    """Runs and files that a copy of a root lacks.

    Attributes:
        policy_files: files of policies that were left out, being neither JSON nor safetensors.
        damaged: a message for each run and file that was left out, since it is damaged.
    """

    policy_files: tuple[str, ...]
    damaged: tuple[str, ...]


def copy_merged(results: Results, target: Store, options: CopyOptions = WHOLE) -> Copy:
    """Copy the tables and policies of a root to an empty place, with files merged.

    What is damaged is left out.

    Raises:
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
        ResultsRootError: `target` is not empty.
    """
    sound, damaged = intact_runs(results, options)
    ours = pa.array([manifest.run.run_id for manifest in sound], pa.string())
    layout.create_root(target)
    packed: list[Manifest] = []
    for name, manifests in grouped(sound, experiments_of(results)).items():
        packed += pack(results, manifests, target, name, lambda: None, options)
    parts: list[pa.Table] = []
    for path in results.store.files(f"{layout.TABLES}/{Table.CELLS}"):
        try:
            parts.append(decode(Table.CELLS, results.store.read_bytes(path)))
        except UNREADABLE as error:
            damaged.append(f"{path}: {error}")
    cells = pa.concat_tables([SCHEMAS[Table.CELLS].empty_table(), *parts]).unify_dictionaries()
    if not options.unfinished:
        cells = cells.filter(pc.is_in(cells["run_id"].cast(pa.string()), ours))
    campaigns = cells["campaign"].cast(pa.string())
    for campaign in sorted(campaigns.unique().to_pylist()):
        rows = cells.filter(pc.equal(campaigns, campaign))
        target.write_bytes(layout.table_path(Table.CELLS, campaign), encode(Table.CELLS, rows))
    left_out = copy_extras(results, target, sound, options)
    write_index(target, packed)
    return Copy(left_out, tuple(dict.fromkeys([*results.problems, *damaged])))


def copy_extras(
    results: Results, target: Store, manifests: Sequence[Manifest], options: CopyOptions
) -> tuple[str, ...]:
    """Copy what runs read, and their policies; returns files of policies that were left out as unsafe."""
    for path in kept_files(results.store, (manifest.run for manifest in manifests)):
        target.write_bytes(path, results.store.read_bytes(path))
    if not options.policies:
        return ()
    ours = {manifest.run.run_id for manifest in manifests}
    left_out = []
    for path in results.store.files(layout.POLICIES):
        chosen = PurePosixPath(path).parts[1] in ours
        if chosen and path.endswith(POLICY_FILES):
            data = results.store.read_bytes(path)
            weights = options.rounded and path.endswith(".safetensors")
            target.write_bytes(path, _halved(data) if weights else data)
        elif chosen or options.runs is None:
            left_out.append(path)
    return tuple(left_out)


def _halved(data: bytes) -> bytes:
    """Return a safetensors file with its matrices of float32 as float16."""
    tensors = {
        name: tensor.astype(np.float16) if tensor.dtype == np.float32 and tensor.ndim == 2 else tensor
        for name, tensor in parse_tensors(data).items()
    }
    return serialise_tensors(tensors)


def intact_runs(results: Results, options: CopyOptions) -> tuple[list[Manifest], list[str]]:
    """Return the runs of a root that are to be copied and whose files are whole, and the damage of others.

    Raises:
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
    """
    sound: list[Manifest] = []
    damaged: list[str] = []
    wanted = [
        manifest
        for manifest in results.runs()
        if (options.unfinished or manifest.status is RunStatus.DONE)
        and (options.runs is None or manifest.run.run_id in options.runs)
    ]
    for manifest, found in Inspector(results.store).inspect_all(wanted):
        if found.newer:
            raise DamagedFileError(newer_version(results.store, found.newer[0]))
        damaged += map(str, found.damage)
        sound += [] if found.damage else [manifest]
    return sound, damaged


def newer_version(store: Store, path: str) -> str:
    """Return the reason why a file with unknown columns is neither merged nor copied."""
    return (
        f"{store.where(path)} was written by a newer tma_ray, with columns that this one would lose: it was "
        f"left as it is; use that version"
    )


@dataclass(frozen=True)
class Compaction:
    """Outcome of a compaction.

    Attributes:
        runs: number of runs whose files were merged.
        files_before: number of files of tables before.
        files_after: number of files of tables after.
        bytes_before: size of those files before, bytes.
        bytes_after: size of those files after, bytes.
    """

    runs: int
    files_before: int
    files_after: int
    bytes_before: int
    bytes_after: int


def compact(root: str | Path) -> Compaction:
    """Merge the files of all runs of a root that are done, experiment by experiment.

    The merged files are written aside, read back and compared; then one manifest after the other is
    switched to them, and what no manifest needs any more is deleted. A kill at any time leaves a root that
    reads the same, and the next call cleans up. Readers may go on; campaigns may not, and continue later.

    Runs that are damaged stay as they are, and so do those written by a newer version with columns that would
    be lost: a `DamagedFileWarning` names each.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: the root does not exist.
        RootInUseError: a campaign is running on it.
        DamagedFileError: a merged file was not written as it should be; nothing refers to it.
    """
    store = Store.open(root)
    layout.check_root(store)
    with Lease(store, f"tma-ray compact (process {os.getpid()} on {socket.gethostname()})") as lease:
        clean(store)
        before = _files(store)
        results = Results(store)
        done = [manifest for manifest in results.runs() if manifest.status is RunStatus.DONE]
        mergeable = []
        for manifest, found in Inspector(store).inspect_all(done):
            reasons = [f"{damage}; not merged" for damage in found.damage]
            reasons += [newer_version(store, path) for path in found.newer]
            for reason in reasons:
                warnings.warn(reason, DamagedFileWarning, stacklevel=2)
            mergeable += [] if reasons else [manifest]
        merged = 0
        for experiment, manifests in grouped(mergeable, experiments_of(results)).items():
            files = {(file.path, file.first is None) for manifest in manifests for file in manifest.files}
            if len(files) > len(DATA_TABLES) or any(is_own for _, is_own in files):
                _merge(results, manifests, experiment, lease)
                merged += len(manifests)
        after = _files(store)
    return Compaction(merged, len(before), len(after), sum(before.values()), sum(after.values()))


def _merge(results: Results, manifests: Sequence[Manifest], experiment: str, lease: Lease) -> None:
    store = results.store
    count, name = 1, experiment
    names = {manifest.run.run_id for manifest in results.runs()}
    tables = [table for table in Table if table is not Table.CELLS]
    while name in names or any(store.exists(layout.table_path(table, name)) for table in tables):
        count += 1
        name = f"{experiment}-{count}"
    new = [layout.table_path(table, name) for table in (*DATA_TABLES, Table.RUNS, Table.ATTEMPTS)]
    old = [file.path for manifest in manifests for file in manifest.files]
    ours, about = {manifest.run.run_id for manifest in manifests}, []
    for table in (Table.RUNS, Table.ATTEMPTS):
        for path in store.files(f"{layout.TABLES}/{table}"):
            with suppress(*UNREADABLE):  # readers name it
                said = decode(table, store.read_bytes(path), ["run_id"])["run_id"].unique().to_pylist()
                if ours.issuperset(said):
                    about.append(path)
    kept = Journal.load(store).unless_used
    Journal((*kept, *new, *old)).write(store)
    packed = pack(results, manifests, store, name, lease.keep)
    Journal((*kept, *new[: len(DATA_TABLES)], *old), tuple(about)).write(store)
    lease.renew()
    for manifest in packed:
        lease.keep()
        store.write_bytes(layout.manifest_path(manifest.run.run_id), manifest.to_bytes())
    clean(store)


def _files(store: Store) -> dict[str, int]:
    return {path: size or 0 for path, (_, size) in store.stamps(layout.TABLES).items()}


@dataclass(frozen=True)
class Shard(Copy):
    """Additions of one batch, and what was left out of it.

    Attributes:
        runs: number of runs that were added.
        cells: number of rows added to the table of cells.
    """

    runs: int
    cells: int


def add_shard(results: Results, target: Store, name: str) -> Shard:
    """Add to a root those runs of another that are done and that it lacks, with their cells.

    No table that is there is changed: each gets one file called `name`, and the index a line for each run.

    Args:
        results: the root of the batch, which may have begun with the runs of `target`.
        target: the root that grows; an empty place becomes one.
        name: name of the new files; letters, digits, "_" and "-".

    Raises:
        ResultsRootError: `target` is not a results root, or has files of that name.
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
    """
    layout.create_root(target)
    before = Results(target)
    known = {manifest.run.run_id for manifest in before.runs()}
    for table in Table:
        if target.exists(layout.table_path(table, name)):
            raise ResultsRootError(
                f"{target.where(layout.table_path(table, name))} exists: choose another name"
            )
    sound, damaged = intact_runs(results, LEAN)
    new = [manifest for manifest in sound if manifest.run.run_id not in known]
    ids = known | {manifest.run.run_id for manifest in new}
    there = {tuple(row.values()) for row in before.table(Table.CELLS).to_pylist()}
    cells = {tuple(row.values()) for row in results.table(Table.CELLS, ids).to_pylist()} - there
    packed = pack(results, new, target, name, lambda: None, LEAN) if new else []
    if cells:
        schema = SCHEMAS[Table.CELLS]
        added = [dict(zip(schema.names, row, strict=True)) for row in sorted(cells)]
        rows = to_arrow(Table.CELLS, schema, added)
        target.write_bytes(layout.table_path(Table.CELLS, name), encode(Table.CELLS, rows))
    unsafe = copy_extras(results, target, new, LEAN)
    write_index(target, (*before.runs(), *packed))
    return Shard(unsafe, tuple(dict.fromkeys([*results.problems, *damaged])), len(new), len(cells))


def start_from(store: Store, source: Store) -> int:
    """Copy the runs of a root that are done, with their cells, to another that lacks them; return how many.

    A campaign on that root takes them as its own, and does what is missing. Files keep their paths.

    Raises:
        ResultsRootError: `source` is not a results root, or a file of that path and another content is there.
        RootInUseError: a campaign is running on `store`.
    """
    layout.check_root(source)
    layout.create_root(store)
    with Lease(store, f"start from {source} (process {os.getpid()} on {socket.gethostname()})") as lease:
        there = {manifest.run.run_id for manifest in Results(store).runs()}
        done = [run for run in Results(source).runs() if run.status is RunStatus.DONE]
        new = [manifest for manifest in done if manifest.run.run_id not in there]
        paths = {file.path for manifest in new for file in manifest.files}
        for table in (table for table in Table if new and table not in DATA_TABLES):
            paths.update(source.files(f"{layout.TABLES}/{table}"))
        for path in sorted(paths.union(source.files(layout.INPUTS)) if new else ()):
            lease.keep()
            data = source.read_bytes(path)
            if not store.exists(path):
                store.write_bytes(path, data)
            elif store.read_bytes(path) != data:
                raise ResultsRootError(
                    f"{store.where(path)} differs from {source.where(path)}: begin in a new folder"
                )
        for manifest in new:  # last: a run is there when its manifest is
            store.write_bytes(layout.manifest_path(manifest.run.run_id), manifest.to_bytes())
    return len(new)
