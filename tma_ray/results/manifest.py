"""The manifest of a run: the one file that readers trust for what it has published."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Self

from tma_ray.decoding import DamagedFileError, Natural, Sha256, SmallNatural, decode_json
from tma_ray.results.layout import TABLES, check_path, manifest_path, staging_folder, table_path
from tma_ray.results.records import RunRecord, RunStatus, check_spec
from tma_ray.results.schema import Table
from tma_ray.results.storage.store import Store

MOST_RUN_ROWS: Final = 50_000_000
"""Rows of one run in a table beyond which its manifest is not believed."""


def read_checked(store: Store, path: str, sha256: str) -> bytes:
    """Returns the content of a file with this checksum.

    Raises:
        FileNotFoundError: the file is not there.
        DamagedFileError: its content is not what was written.
    """
    data = store.read_bytes(path)
    if hashlib.sha256(data).hexdigest() != sha256:
        raise DamagedFileError(f"{store.where(path)} is damaged: its sha256 is not the recorded one")
    return data


@dataclass(frozen=True)
class PartFile:
    """One Parquet file of a run, or the run's rows in a file that many runs share.

    Attributes:
        table: whose rows it holds.
        path: where it lies, from the results root.
        rows: how many are the run's.
        sha256: of the bytes of the file, hexadecimal.
        first: row of the file at which the run's begin; None for a file of the run alone.
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
        """Writes `data`, the encoded `rows` of `table`, and returns the file that it became."""
        store.write_bytes(path, data)
        return cls(table, path, rows, hashlib.sha256(data).hexdigest())

    def read(self, store: Store) -> bytes:
        """Returns the content.

        Raises:
            FileNotFoundError: the file is not there.
            DamagedFileError: its content is not what was written.
        """
        return read_checked(store, self.path, self.sha256)

    def at(self, path: str) -> Self:
        """Returns the same content at another path."""
        return replace(self, path=path)

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as JSON values."""
        value = asdict(self)
        return value if self.first is not None else {k: v for k, v in value.items() if k != "first"}


@dataclass(frozen=True)
class Manifest:
    """Published files and state of a run.

    Attributes:
        run: what the run is.
        status: how far it is.
        attempt: the accepted attempt; older ones may publish nothing any more.
        files: parts in order while it runs, one canonical file per data table when it is done.
        error: why it failed.
    """

    run: RunRecord
    status: RunStatus
    attempt: SmallNatural
    files: tuple[PartFile, ...] = ()
    error: str | None = None

    def to_bytes(self) -> bytes:
        """Returns the content of the manifest file."""
        content = asdict(self) | {"files": [file.to_json() for file in self.files]}
        return json.dumps(content, indent=1).encode()

    @staticmethod
    def load(store: Store, run_id: str) -> Manifest:
        """Returns the manifest of a run.

        Raises:
            FileNotFoundError: the run has published nothing.
            DamagedFileError: as `load_manifest` does.
        """
        return load_manifest(store, manifest_path(run_id))

    def check(self, run_id: str) -> None:
        """Refuses a manifest that cannot be that of `run_id`.

        Raises:
            ValueError: that of another run, one whose spec is not its own, or one that lists files of others.
        """
        if self.run.run_id != run_id:
            raise ValueError(f"it is about another run, {self.run.run_id!r}")
        check_spec(self.run)
        for file in self.files:
            own = file.path == table_path(file.table, run_id) or file.path.startswith(
                f"{staging_folder(run_id)}/"
            )
            shared = file.first is not None and file.path.startswith(f"{TABLES}/{file.table}/")
            if not (own or shared):
                raise ValueError(f"it lists {file.path}, which does not belong to run {run_id}")
        largest = max(self.files, key=lambda file: file.rows, default=None)
        if largest is not None and largest.rows > MOST_RUN_ROWS:
            raise ValueError(f"it lists {largest.rows:,} rows in {largest.path}, more than any run has")
        listed = [(file.path, file.first) for file in self.files]
        if len(set(listed)) < len(listed):
            raise ValueError("it lists a file twice")

    def row(self) -> dict[str, Any]:
        """Returns the row of the table of runs."""
        return {**vars(self.run), "status": self.status.value, "error": self.error}


def load_manifest(store: Store, path: str) -> Manifest:
    """Returns the manifest at `path`.

    Raises:
        FileNotFoundError: there is none.
        DamagedFileError: it is not a manifest, is that of another run, or lists what cannot be this run's.
    """
    manifest = decode_json(store.read_bytes(path), Manifest, store.where(path))
    try:
        manifest.check(path.rpartition("/")[2].removesuffix(".json"))
    except ValueError as error:
        raise DamagedFileError(f"{store.where(path)} is damaged: {error}") from error
    return manifest
