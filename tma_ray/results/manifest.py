"""The manifest of a run: the one file that readers trust for what it has published."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from tma_ray.results.layout import check_path, manifest_path
from tma_ray.results.records import RunRecord, RunStatus
from tma_ray.results.schema import Table
from tma_ray.results.storage.store import Store


class DamagedFileError(ValueError):
    """A file whose content is not what was written; the message names it."""


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
    rows: int
    sha256: str
    first: int | None = None

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
        data = store.read_bytes(self.path)
        if hashlib.sha256(data).hexdigest() != self.sha256:
            raise DamagedFileError(f"{store.where(self.path)} is damaged: its sha256 is not the recorded one")
        return data

    def at(self, path: str) -> Self:
        """Returns the same content at another path."""
        return replace(self, path=path)

    def to_json(self) -> dict[str, Any]:
        """Returns the fields as JSON values."""
        value = asdict(self)
        return value if self.first is not None else {k: v for k, v in value.items() if k != "first"}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """Returns what `to_json` was called on."""
        path, first = check_path(value["path"]), value.get("first")
        return cls(Table(value["table"]), path, value["rows"], value["sha256"], first)


@dataclass(frozen=True)
class Manifest:
    """What a run has published.

    Attributes:
        run: what the run is.
        status: how far it is.
        attempt: the accepted attempt; older ones may publish nothing any more.
        files: parts in order while it runs, one canonical file per data table when it is done.
        error: why it failed.
    """

    run: RunRecord
    status: RunStatus
    attempt: int
    files: tuple[PartFile, ...] = ()
    error: str | None = None

    def to_bytes(self) -> bytes:
        """Returns the content of the manifest file."""
        content = asdict(self) | {"files": [file.to_json() for file in self.files]}
        return json.dumps(content, indent=1).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Returns what `to_bytes` was called on.

        Raises:
            DamagedFileError: `data` is not a manifest.
        """
        try:
            content = json.loads(data)
            return cls(
                run=RunRecord(**content["run"]),
                status=RunStatus(content["status"]),
                attempt=content["attempt"],
                files=tuple(PartFile.from_json(file) for file in content["files"]),
                error=content["error"],
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DamagedFileError(f"not a manifest: {error!r}") from error

    @classmethod
    def load(cls, store: Store, run_id: str) -> Self:
        """Returns the manifest of a run.

        Raises:
            FileNotFoundError: the run has published nothing.
            DamagedFileError: the file is not a manifest.
        """
        path = manifest_path(run_id)
        try:
            manifest = cls.from_bytes(store.read_bytes(path))
            if manifest.run.run_id != run_id:
                raise DamagedFileError(f"it is about another run, {manifest.run.run_id!r}")
            return manifest
        except DamagedFileError as error:
            raise DamagedFileError(f"{store.where(path)} is damaged: {error}") from error

    def row(self) -> dict[str, Any]:
        """Returns the row of the table of runs."""
        return {**asdict(self.run), "status": self.status.value, "error": self.error}
