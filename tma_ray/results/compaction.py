"""Merging of many runs' files: compaction of roots, merged copies and shards of releases."""

import os
import re
import socket
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
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
from tma_ray.results.inputs import stored_inputs
from tma_ray.results.lease import Lease
from tma_ray.results.manifest import UNREADABLE, Manifest, PartFile, write_index
from tma_ray.results.parquet import decode, decode_rows, encode, encode_together, same_rows
from tma_ray.results.reader import Results
from tma_ray.results.records import RunRecord, RunStatus, mastery_threshold
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table, to_arrow
from tma_ray.results.storage import ResultsRootError, Store
from tma_ray.results.verification import Inspector
from tma_ray.support.decoding import DamagedFileError, DamagedFileWarning

SINGLE_RUNS = "single_runs"  # experiment name given to runs without a campaign


@dataclass(frozen=True)
class CopyOptions:
    """Options for copying a root.

    Attributes:
        tables: data tables to copy.
        unfinished: True to copy runs that are not done.
        policies: True to copy final policies.
        hosts: True to keep host names in the table of attempts.
        runs: ids of the runs to copy, None for all.
        reduced: True to round values to `SIGNIFICANT_BITS` and weights of policies to float16, and to keep at
            most `MOST_PROBES` probes of a curriculum.
    """

    tables: tuple[Table, ...] = DATA_TABLES
    unfinished: bool = True
    policies: bool = True
    hosts: bool = True
    runs: frozenset[str] | None = None
    reduced: bool = False


WHOLE: Final = CopyOptions()

LEAN: Final = CopyOptions(
    (Table.EVALUATIONS, Table.TRAINING, Table.CURRICULUM),
    unfinished=False,
    policies=False,
    hosts=False,
    reduced=True,
)
"""Options of a small copy (10 to 50 kB per run), without episodes, teacher logs, policies and hosts."""

SIGNIFICANT_BITS: Final = {Table.EVALUATIONS: ("episodic_return", 24), Table.CURRICULUM: ("task", 12)}
"""Rounded columns and their significant bits (relative errors of 6e-8 and 2.4e-4); further bits are noise,
which does not compress."""

MOST_PROBES: Final = 20
"""Largest number of probes of a run in a reduced copy, evenly spaced up to the last one. Tasks of many
dimensions would otherwise take most of its size."""


def experiments_of(results: Results, run_ids: Collection[str] | None = None) -> dict[str, str]:
    """Return the experiment of each run that has one, by run id; if it has several, the first by name.

    Args:
        results: root of the runs.
        run_ids: ids of the runs; all by default.
    """
    cells = results.table(Table.CELLS, run_ids, ["experiment", "run_id"]).to_pylist()
    cells.sort(key=lambda cell: cell["experiment"], reverse=True)
    return {cell["run_id"]: cell["experiment"] for cell in cells}


def grouped(manifests: Sequence[Manifest], experiments: Mapping[str, str]) -> dict[str, list[Manifest]]:
    """Group manifests by experiment (its name made safe for file names), each group sorted by run id."""
    groups: dict[str, list[Manifest]] = {}
    for manifest in sorted(manifests, key=lambda manifest: manifest.run.run_id):
        experiment = experiments.get(manifest.run.run_id, SINGLE_RUNS)
        name = re.sub(r"[^0-9a-zA-Z_-]", "_", experiment) or SINGLE_RUNS
        groups.setdefault(name, []).append(manifest)
    return dict(sorted(groups.items()))


def pack(
    results: Results,
    manifests: Sequence[Manifest],
    target: Store,
    name: str,
    tick: Callable[[], None],
    options: CopyOptions = WHOLE,
) -> list[Manifest]:
    """Merge the rows of some runs into one verified file per table, and return the runs' new manifests.

    Args:
        results: root of the runs.
        manifests: manifests of the runs, sorted by run id.
        target: root to write to, perhaps the same.
        name: name of the new files.
        tick: function called between runs, for example to renew a lease.
        options: tables and files to write.
    """
    slices: dict[str, list[PartFile]] = {manifest.run.run_id: [] for manifest in manifests}
    for table in options.tables:
        for run_id, file in _pack_table(results, manifests, target, (table, name), tick, options):
            slices[run_id].append(file)
    for table in (Table.RUNS, Table.ATTEMPTS):
        rows, path = results.table(table, list(slices)), layout.table_path(table, name)
        if table is Table.ATTEMPTS and not options.hosts:
            column = rows.schema.get_field_index("host")
            field = rows.schema.field(column)
            empty = pa.array([""] * len(rows), pa.string()).dictionary_encode().cast(field.type)
            rows = rows.set_column(column, field, empty)
        PartFile.write(target, path, table, len(rows), encode(table, rows)).read(target)
    return [replace(manifest, files=tuple(slices[manifest.run.run_id])) for manifest in manifests]


def _rows_of(results: Results, table: Table, run: RunRecord, reduced: bool) -> pa.Table:
    """Return the rows of one run, or raise a DamagedFileError if any are unreadable."""
    before = len(results.problems)
    rows = results.table(table, [run.run_id])
    if len(results.problems) > before:
        raise DamagedFileError(f"nothing was merged: {results.problems[before]}")
    if not reduced or table not in SIGNIFICANT_BITS:
        return rows
    return _rounded(_thinned(rows) if table is Table.CURRICULUM else rows, table, run)


def _thinned(probes: pa.Table) -> pa.Table:
    """Return the rows of every k-th probe of a run up to its last one, with the smallest k that suffices."""
    steps = np.unique(probes["step"].to_numpy())
    every = -(-len(steps) // MOST_PROBES) or 1
    return probes.filter(pc.is_in(probes["step"], pa.array(steps[::-1][::every])))


def _rounded(rows: pa.Table, table: Table, run: RunRecord) -> pa.Table:
    """Round `rows` to fewer significant bits, keeping returns on their side of the mastery threshold."""
    name, bits = SIGNIFICANT_BITS[table]
    column = rows.schema.get_field_index(name)
    values = rows[name].combine_chunks()
    exact = (values.values if table is Table.CURRICULUM else values).to_numpy()
    significand, exponent = np.frexp(exact)
    fewer = np.ldexp(np.round(np.ldexp(significand, bits)), exponent - bits)
    if table is Table.CURRICULUM:
        fewer = pa.ListArray.from_arrays(values.offsets, fewer).cast(values.type)
    else:
        threshold = mastery_threshold(run)
        fewer = pa.array(np.where((fewer > threshold) == (exact > threshold), fewer, exact))
    return rows.set_column(column, rows.schema.field(column), fewer)


def _pack_table(
    results: Results,
    manifests: Sequence[Manifest],
    target: Store,
    file: tuple[Table, str],
    tick: Callable[[], None],
    options: CopyOptions,
) -> Iterator[tuple[str, PartFile]]:
    table, name = file
    counts: dict[str, int] = {}

    def parts() -> Iterator[pa.Table]:
        for manifest in manifests:
            tick()
            rows = _rows_of(results, table, manifest.run, options.reduced)
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
        expected = _rows_of(results, table, manifest.run, options.reduced)
        count, names = counts[run_id], SCHEMAS[table].names
        rows = decode_rows(table, stored, first, count, names) if count else expected
        if not same_rows(table, rows, expected):
            raise DamagedFileError(
                f"{target.where(path)} does not hold what run {run_id} wrote; nothing was merged"
            )
        yield run_id, replace(written, rows=count, first=first)
        first += count


JOURNAL: Final = "compacting.json"  # journal of a compaction in progress

_MERGED: Final = re.compile(rf"{layout.TABLES}/[^/]+/[^/]+\.parquet")


@dataclass(frozen=True)
class Journal:
    """Files to delete after a compaction: those that no manifest lists, and those that were replaced."""

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
        """Return the journal of a root, or an empty one if it is missing or damaged."""
        try:
            return store.read_json(JOURNAL, cls)
        except FileNotFoundError:
            return cls()
        except DamagedFileError as error:  # the files to delete then stay, but no reader uses them
            warnings.warn(str(error), DamagedFileWarning, stacklevel=2)
            return cls()

    def write(self, store: Store) -> None:
        """Write this journal to a root."""
        store.write_json(JOURNAL, Journal(tuple(sorted(set(self.unless_used))), self.replaced))


def clean(store: Store) -> None:
    """Delete the unused and replaced files that the journal lists, and then the journal.

    If manifests are unreadable, files that they may list are kept.
    """
    if not store.exists(JOURNAL):
        return
    journal, results = Journal.load(store), Results(store)
    used = {file.path for manifest in results.runs() for file in manifest.files}
    readable = {manifest.run.run_id for manifest in results.runs()}
    unused = [path for path in journal.unless_used if path not in used]
    doubtful = [
        path
        for path in unused
        if results.problems and readable.isdisjoint((*PurePosixPath(path).parts, PurePosixPath(path).stem))
    ]
    for path in (*(path for path in unused if path not in doubtful), *journal.replaced):
        store.delete(path)
    if doubtful:
        Journal(tuple(doubtful)).write(store)
    else:
        store.delete(JOURNAL)


POLICY_FILES: Final = (".json", ".safetensors")  # suffixes of policy files that are safe to read


@dataclass(frozen=True)
class Copy:
    """Outcome of copying a root: the files left out.

    Attributes:
        policy_files: policy files that are neither JSON nor safetensors.
        damaged: messages about damaged runs and files.
    """

    policy_files: tuple[str, ...]
    damaged: tuple[str, ...]


def copy_merged(results: Results, target: Store, options: CopyOptions = WHOLE) -> Copy:
    """Copy the intact runs of a root to an empty store, merging their files.

    Raises:
        DamagedFileError: if a file of a newer version has columns that would be lost.
        ResultsRootError: if `target` is not empty.
    """
    sound, damaged = intact_runs(results, options)
    ids = pa.array([manifest.run.run_id for manifest in sound], pa.string())
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
        cells = cells.filter(pc.is_in(cells["run_id"].cast(pa.string()), ids))
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
    """Copy the inputs and policies of runs, and return the paths of unsafe policy files left out."""
    for path in stored_inputs(results.store, (manifest.run for manifest in manifests)):
        target.write_bytes(path, results.store.read_bytes(path))
    if not options.policies:
        return ()
    ids = {manifest.run.run_id for manifest in manifests}
    left_out = []
    for path in results.store.files(layout.POLICIES):
        chosen = PurePosixPath(path).parts[1] in ids
        if chosen and path.endswith(POLICY_FILES):
            data = results.store.read_bytes(path)
            weights = options.reduced and path.endswith(".safetensors")
            target.write_bytes(path, _halved(data) if weights else data)
        elif chosen or options.runs is None:
            left_out.append(path)
    return tuple(left_out)


def _halved(data: bytes) -> bytes:
    """Return a safetensors file with its float32 matrices converted to float16."""
    tensors = {
        name: tensor.astype(np.float16) if tensor.dtype == np.float32 and tensor.ndim == 2 else tensor
        for name, tensor in parse_tensors(data).items()
    }
    return serialise_tensors(tensors)


def intact_runs(results: Results, options: CopyOptions) -> tuple[list[Manifest], list[str]]:
    """Return the intact runs to copy from a root, and a description of each damaged file."""
    sound: list[Manifest] = []
    damaged: list[str] = []
    selected = [
        manifest
        for manifest in results.runs()
        if (options.unfinished or manifest.status is RunStatus.DONE)
        and (options.runs is None or manifest.run.run_id in options.runs)
    ]
    for manifest, inspection in Inspector(results.store).inspect_all(selected):
        if inspection.newer:
            raise DamagedFileError(newer_version(results.store, inspection.newer[0]))
        damaged += map(str, inspection.damage)
        sound += [] if inspection.damage else [manifest]
    return sound, damaged


def newer_version(store: Store, path: str) -> str:
    """Return a message about a file that is neither merged nor copied, since it has unknown columns."""
    return (
        f"{store.where(path)} was written by a newer tma_ray, with columns that this one would lose: it was "
        f"left as it is; use that version"
    )


@dataclass(frozen=True)
class Compaction:
    """Outcome of a compaction: merged runs, and number and size of table files before and after."""

    runs: int
    files_before: int
    files_after: int
    bytes_before: int
    bytes_after: int


def compact(root: str | Path) -> Compaction:
    """Merge the files of all finished runs of a root, experiment by experiment.

    Merged files are verified before manifests are switched to them, one by one, and unused files deleted. A
    crash leaves a readable root, which the next call cleans up. Readers may run at the same time, campaigns
    may not. Damaged runs, and those of a newer version with unknown columns, stay with a
    `DamagedFileWarning`.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: if the root does not exist.
        RootInUseError: if a campaign is running on it.
        DamagedFileError: if a merged file was not written correctly.
    """
    store = Store.open(root)
    layout.check_root(store)
    with Lease(store, f"tma-ray compact (process {os.getpid()} on {socket.gethostname()})") as lease:
        clean(store)
        before = _files(store)
        results = Results(store)
        done = [manifest for manifest in results.runs() if manifest.status is RunStatus.DONE]
        mergeable = []
        for manifest, inspection in Inspector(store).inspect_all(done):
            reasons = [f"{damage}; not merged" for damage in inspection.damage]
            reasons += [newer_version(store, path) for path in inspection.newer]
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
    ids, about = {manifest.run.run_id for manifest in manifests}, []
    for table in (Table.RUNS, Table.ATTEMPTS):
        for path in store.files(f"{layout.TABLES}/{table}"):
            with suppress(*UNREADABLE):  # a damaged file is reported when results are read
                listed = decode(table, store.read_bytes(path), ["run_id"])["run_id"].unique().to_pylist()
                if ids.issuperset(listed):
                    about.append(path)
    unused = Journal.load(store).unless_used
    Journal((*unused, *new, *old)).write(store)
    packed = pack(results, manifests, store, name, lease.keep)
    Journal((*unused, *new[: len(DATA_TABLES)], *old), tuple(about)).write(store)
    lease.renew()
    for manifest in packed:
        lease.keep()
        store.write_bytes(layout.manifest_path(manifest.run.run_id), manifest.to_bytes())
    clean(store)


def _files(store: Store) -> dict[str, int]:
    return {path: size or 0 for path, (_, size) in store.stamps(layout.TABLES).items()}


@dataclass(frozen=True)
class Shard(Copy):
    """Outcome of adding a shard: the numbers of added runs and cells, and the files left out."""

    runs: int
    cells: int


def add_shard(results: Results, target: Store, name: str) -> Shard:
    """Copy the finished runs missing from `target`, with their cells, into new files.

    Args:
        results: root of the new runs.
        target: root that grows, or an empty store.
        name: name of the new files (letters, digits, "_" and "-").

    Raises:
        ResultsRootError: if `target` is not a results root, or has files of that name.
        DamagedFileError: if a file of a newer version has columns that would be lost.
    """
    layout.create_root(target)
    before = Results(target)
    existing = {manifest.run.run_id for manifest in before.runs()}
    for table in Table:
        if target.exists(layout.table_path(table, name)):
            raise ResultsRootError(
                f"{target.where(layout.table_path(table, name))} exists: choose another name"
            )
    sound, damaged = intact_runs(results, LEAN)
    new = [manifest for manifest in sound if manifest.run.run_id not in existing]
    ids = existing | {manifest.run.run_id for manifest in new}
    cells = {tuple(row.values()) for row in results.table(Table.CELLS, ids).to_pylist()}
    cells -= {tuple(row.values()) for row in before.table(Table.CELLS).to_pylist()}
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
    """Copy from `source` the finished runs missing from `store`, with their cells; return their number.

    A campaign on that root then only runs what is missing.

    Raises:
        ResultsRootError: if `source` is not a results root, or `store` has another file at the same path.
        RootInUseError: if a campaign is running on `store`.
    """
    layout.check_root(source)
    layout.create_root(store)
    with Lease(store, f"start from {source} (process {os.getpid()} on {socket.gethostname()})") as lease:
        existing = {manifest.run.run_id for manifest in Results(store).runs()}
        done = [run for run in Results(source).runs() if run.status is RunStatus.DONE]
        new = [manifest for manifest in done if manifest.run.run_id not in existing]
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
        for manifest in new:  # written last, since manifests make runs visible
            store.write_bytes(layout.manifest_path(manifest.run.run_id), manifest.to_bytes())
    return len(new)
