"""Checkpoints of a run: complete or absent, checksummed, never written twice under one name."""

from __future__ import annotations

import hashlib
import json
import logging
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from tma_ray.results import CHECKPOINTS, PartFile, Store, check_id, check_path
from tma_ray.runs.run import Run

INDEX = "index.json"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Checkpoint:
    """One complete checkpoint.

    Attributes:
        folder: where it lies, from the results root.
        step: environment steps of the run.
        fingerprint: of the machine that wrote it.
        parts: result rows that belong to the run so far.
        files: sha256 by file name.
    """

    folder: str
    step: int
    fingerprint: str
    parts: tuple[PartFile, ...]
    files: dict[str, str]


class Checkpoints:
    """The checkpoints of one run, as one attempt sees them.

    A checkpoint exists once its index does, which is written last. Names hold the attempt, so that
    a lost attempt that comes back to life never writes into its successor's. They hold pickles: load
    them from your own results root only.
    """

    def __init__(self, store: Store, run_id: str, attempt: int) -> None:
        self._store = store
        self._folder = f"{CHECKPOINTS}/{check_id(run_id)}"
        self._attempt = attempt

    def save(self, run: Run, parts: Sequence[PartFile], fingerprint: str) -> int:
        """Writes a checkpoint of `run`, then drops all but the one before it; returns its bytes."""
        step = run.progress.step
        folder = f"{self._folder}/{step:012d}-attempt-{self._attempt:03d}"
        files, size = {}, 0
        with tempfile.TemporaryDirectory() as place:
            run.save(Path(place))
            for path in sorted(p for p in Path(place).rglob("*") if p.is_file()):
                name, data = path.relative_to(place).as_posix(), path.read_bytes()
                self._store.write_bytes(f"{folder}/{name}", data)
                files[name] = hashlib.sha256(data).hexdigest()
                size += len(data)
        index = {
            "step": step,
            "fingerprint": fingerprint,
            "parts": [part.to_json() for part in parts],
            "files": files,
        }
        self._store.write_bytes(f"{folder}/{INDEX}", json.dumps(index).encode())
        for old in self._folders()[:-2]:
            self._store.delete(old)
        return size

    def restore(self, run: Run) -> Checkpoint | None:
        """Loads the newest complete and undamaged checkpoint into a new `run`; returns it, or None."""
        for folder in reversed(self._folders()):
            if not self._store.exists(f"{folder}/{INDEX}"):
                continue
            with tempfile.TemporaryDirectory() as place:
                checkpoint = self._fetch(folder, Path(place))
                if checkpoint is None:
                    logger.warning(
                        "checkpoint %s is damaged; trying the one before", self._store.where(folder)
                    )
                    continue
                run.load(Path(place))
                return checkpoint
        return None

    def drop(self) -> None:
        """Deletes all checkpoints of the run; called once its results are published."""
        self._store.delete(self._folder)

    def _folders(self) -> list[str]:
        """Folders of checkpoints, oldest step first."""
        files = self._store.files(self._folder)
        depth = len(PurePosixPath(self._folder).parts)
        return sorted({"/".join(PurePosixPath(file).parts[: depth + 1]) for file in files})

    def _fetch(self, folder: str, place: Path) -> Checkpoint | None:
        try:
            index = json.loads(self._store.read_bytes(f"{folder}/{INDEX}"))
            for name, digest in index["files"].items():
                data = self._store.read_bytes(f"{folder}/{name}")
                if hashlib.sha256(data).hexdigest() != digest:
                    return None
                target = place / PurePosixPath(check_path(name))
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            parts = tuple(PartFile.from_json(part) for part in index["parts"])
            return Checkpoint(folder, index["step"], index["fingerprint"], parts, index["files"])
        except (ValueError, KeyError, FileNotFoundError):
            return None
