"""Atomic, checksummed and incremental checkpoints of runs, and saved policies."""

import hashlib
import json
import logging
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from tma_ray.results import (
    CHECKPOINTS,
    DISK_FULL,
    POLICIES,
    PartFile,
    Results,
    ResultsRootError,
    Store,
    check_id,
    check_path,
    explained_disk,
    policy_folder,
)
from tma_ray.runs.inputs import fetch, fetch_beside
from tma_ray.runs.run import Run
from tma_ray.runs.spec import RunSpec
from tma_ray.students import PolicyFileError, load_policy
from tma_ray.support.decoding import DamagedFileError, Natural, Sha256, decode_json

INDEX = "index.json"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class StateFile:
    """File of a checkpoint, with its checksum and size.

    Attributes:
        path: path in the folder of the run's checkpoints, in this checkpoint or an earlier one.
        sha256: digest of its bytes, hexadecimal.
        size: size in bytes.
    """

    path: str
    sha256: Sha256
    size: Natural

    def __post_init__(self) -> None:
        check_path(self.path)


@dataclass(frozen=True)
class Checkpoint:
    """Complete checkpoint of a run: its state files, and the result rows so far.

    Attributes:
        step: environment steps of the run.
        fingerprint: fingerprint of the machine that wrote it.
        parts: result rows that belong to the run so far.
        files: state files by their path in a saved run.
        name: name of its folder, not stored in the index.
    """

    step: Natural
    fingerprint: str
    parts: tuple[PartFile, ...]
    files: Mapping[str, StateFile]
    name: str = ""

    def __post_init__(self) -> None:
        for path in self.files:
            check_path(path)

    def to_bytes(self) -> bytes:
        """Return the content of the index file."""
        content = {
            "step": self.step,
            "fingerprint": self.fingerprint,
            "parts": [part.to_json() for part in self.parts],
            "files": {name: asdict(file) for name, file in self.files.items()},
        }
        return json.dumps(content).encode()

    @classmethod
    def from_bytes(cls, name: str, data: bytes) -> "Checkpoint":
        """Return the checkpoint described by an index file.

        Raises:
            DamagedFileError: if the index is invalid.
        """
        return replace(decode_json(data, cls, f"the index of checkpoint {name}"), name=name)


class Checkpoints:
    """Reader and writer of one run's checkpoints for a single attempt.

    The index of a checkpoint is written last and makes it valid. Files unchanged since the previous
    checkpoint, such as full segments of a replay buffer, are referenced and not written again. Names contain
    the attempt, and attempts delete nothing of later ones: a stale attempt that goes on does no harm.
    Checkpoints contain pickles: load only those of a trusted results root.
    """

    def __init__(self, store: Store, run_id: str, attempt: int) -> None:
        self._store = store
        self._folder = f"{CHECKPOINTS}/{check_id(run_id)}"
        self._attempt = attempt
        self._latest: Checkpoint | None = None  # the checkpoint last written or loaded
        self._intact = False  # True if `_latest` is the state that the run last saved or loaded

    def save(self, run: Run, parts: Sequence[PartFile], fingerprint: str) -> int:
        """Write a checkpoint of `run`, keep one older checkpoint, and return the number of bytes written."""
        step = run.progress.step
        name = f"{step:012d}-attempt-{self._attempt:03d}"
        incremental, self._intact = self._intact, False  # stays False until the index is written
        with tempfile.TemporaryDirectory() as folder, explained_disk(folder, DISK_FULL):
            unchanged = run.save(Path(folder), incremental)
            new = {}
            for source in sorted(path for path in Path(folder).rglob("*") if path.is_file()):
                path, data = source.relative_to(folder).as_posix(), source.read_bytes()
                self._store.write_bytes(f"{self._folder}/{name}/{path}", data)
                new[path] = StateFile(f"{name}/{path}", hashlib.sha256(data).hexdigest(), len(data))
        before = self._latest.files if self._latest and unchanged else {}
        files = {**{path: before[path] for path in unchanged}, **new}
        checkpoint = Checkpoint(step, fingerprint, tuple(parts), files, name)
        index = checkpoint.to_bytes()
        self._store.write_bytes(f"{self._folder}/{name}/{INDEX}", index)
        self._tidy([checkpoint, self._latest] if self._latest else [checkpoint])
        self._latest, self._intact = checkpoint, True
        return len(index) + sum(file.size for file in new.values())

    def restore(self, run: Run) -> Checkpoint | None:
        """Load the newest intact checkpoint into a new `run` and return it, or None if there is none."""
        indices = [path for path in self._store.files(self._folder) if path.endswith(f"/{INDEX}")]
        for path in reversed(indices):
            with tempfile.TemporaryDirectory() as folder:
                checkpoint = self._fetch(PurePosixPath(path).parent.name, Path(folder))
                if checkpoint is None:
                    logger.warning("checkpoint %s is damaged; trying the one before", self._store.where(path))
                    continue
                run.load(Path(folder))
                self._latest, self._intact = checkpoint, True
                return checkpoint
        return None

    def drop(self) -> None:
        """Delete all checkpoints of the run after its results have been published."""
        self._store.delete(self._folder)

    def _tidy(self, kept: Sequence[Checkpoint]) -> None:
        """Delete files that no kept checkpoint needs, indices first, since they make checkpoints valid."""
        needed = {f"{checkpoint.name}/{INDEX}" for checkpoint in kept}
        needed |= {file.path for checkpoint in kept for file in checkpoint.files.values()}
        folders: dict[str, list[str]] = {}
        for path in self._store.files(self._folder):
            inner = path.removeprefix(f"{self._folder}/")
            folders.setdefault(inner.split("/")[0], []).append(inner)
        for folder, paths in folders.items():
            number = folder.rpartition("-attempt-")[2]
            if number.isdigit() and int(number) > self._attempt:
                continue
            if needed.isdisjoint(paths):
                self._store.delete(f"{self._folder}/{folder}")
                continue
            for inner in sorted(set(paths) - needed):  # "index.json" sorts before "run.pickle" and "student/"
                self._store.delete(f"{self._folder}/{inner}")

    def _fetch(self, name: str, folder: Path) -> Checkpoint | None:
        try:
            data = self._store.read_bytes(f"{self._folder}/{name}/{INDEX}")
            checkpoint = Checkpoint.from_bytes(name, data)
            for path, file in checkpoint.files.items():
                data = self._store.read_bytes(f"{self._folder}/{file.path}")
                if hashlib.sha256(data).hexdigest() != file.sha256:
                    return None
                target = folder / PurePosixPath(path)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            for part in checkpoint.parts:
                part.read(self._store)
        except (FileNotFoundError, DamagedFileError):
            return None
        return checkpoint


ResultT = TypeVar("ResultT")

StepPolicy = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Function from an observation (o,) to an action (a,)."""

SPEC_FILE = "spec.json"  # name of the file with the spec of a run, next to its saved policy


@dataclass(frozen=True)
class SavedPolicy:
    """Policy saved in a folder, with the spec of the run that trained it.

    Attributes:
        store: store of its files.
        folder: folder of its files in the store.
        spec: spec of the run.
    """

    store: Store
    folder: str
    spec: RunSpec

    def copy(self, folder: Path) -> None:
        """Copy the policy's files, without subfolders, to an existing folder."""
        for path in map(PurePosixPath, self.store.files(self.folder)):
            if path.parent == PurePosixPath(self.folder):
                (folder / path.name).write_bytes(self.store.read_bytes(str(path)))

    def read(self, folder: Path, reader: Callable[[str, Path], ResultT]) -> ResultT:
        """Call `reader` with the student's name and `folder`, a copy of the policy; return the result."""
        try:
            return reader(self.spec.student, folder)
        except PolicyFileError as error:  # the error names the copy instead of the original
            where = self.store.where(f"{self.folder}/{error.file.name}")
            raise PolicyFileError(where, error.problem) from error

    def load(self, observations: spaces.Box, actions: spaces.Box) -> StepPolicy:
        """Return the policy as a function from observation to action, without exploration.

        Raises:
            PolicyFileError: if a file is missing, damaged or of another format.
            ValueError: if the policy has other spaces.
        """
        with tempfile.TemporaryDirectory() as temporary:
            self.copy(Path(temporary))
            policy = self.read(Path(temporary), load_policy)
        try:
            shape = policy(np.zeros((1, *observations.shape), np.float32)).shape
        except (ValueError, RuntimeError):  # raised by numpy's and torch's matrix products
            shape = ()
        if shape != (1, *actions.shape):
            raise ValueError(
                f"the policy of {self.spec.run_id} does not fit {observations.shape[0]} observations and "
                f"{actions.shape[0]} actions; it was trained in {self.spec.environment} with "
                f"{self.spec.embodiment or 'no body'}"
            )
        return lambda observation: policy(observation[None])[0]


def find_policy(name: str, results: str | Path) -> SavedPolicy:
    """Return the saved policy of a run, and read the run's input files into memory.

    Args:
        name: folder of a saved policy or a file in it, or the id of a run or an unambiguous prefix.
        results: results root of the run.

    Raises:
        ValueError: if the policy does not exist, or the prefix is ambiguous.
    """
    path = Path(name)
    if path.exists() or path.is_symlink():
        folder = path.absolute() if path.is_dir() else path.absolute().parent
        try:
            saved = _in_folder(Store.open(folder.parent), folder.name)
        except ValueError as error:
            raise ValueError(f"policy {name!r}: {error}") from error
        fetch_beside(folder, saved.spec)
        if saved.spec.inputs and folder.parent.name == POLICIES:
            fetch(Store.open(folder.parent.parent), saved.spec)
        return saved
    try:
        root = Results.open(results)
    except ResultsRootError as error:
        raise ValueError(f"no policy {name!r}: it is not a folder, and {error}") from error
    saved = _in_folder(root.store, policy_folder(root.find(name).run.run_id))
    fetch(root.store, saved.spec)
    return saved


def results_of(saved: SavedPolicy, results: str | Path) -> Results | None:
    """Return the results that contain a policy's run, from the policy's own root or `results`, or None."""
    folder = Path(saved.store.where(saved.folder))
    in_root = not saved.store.is_object_store and folder.parent.name == POLICIES
    for path in [folder.parent.parent, results] if in_root else [results]:
        try:
            root = Results.open(path)
        except ResultsRootError:
            continue
        if any(manifest.run.run_id == saved.spec.run_id for manifest in root.runs()):
            return root
    return None


def _in_folder(store: Store, folder: str) -> SavedPolicy:
    path = f"{folder}/{SPEC_FILE}"
    if not store.exists(path):
        raise ValueError(
            f"no policy is saved in {store.where(folder)}: {SPEC_FILE} is missing; "
            f"a run saves its policy when it ends"
        )
    try:
        spec = RunSpec.from_json(store.read_bytes(path), store.where(path))
    except DamagedFileError as error:
        raise ValueError(f"{error}; copy the folder again") from error
    return SavedPolicy(store, folder, spec)
