"""Saved policies of runs."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from tma_ray.results import POLICIES, Results, ResultsRootError, Store, policy_folder
from tma_ray.runs.inputs import fetch, fetch_beside
from tma_ray.runs.spec import RunSpec
from tma_ray.students import PolicyFileError, load_policy
from tma_ray.support.decoding import DamagedFileError

ResultT = TypeVar("ResultT")

StepPolicy = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Function from an observation (o,) to an action (a,)."""

SPEC_FILE = "spec.json"  # name of the file with the spec of a run, next to its saved policy


@dataclass(frozen=True)
class SavedPolicy:
    """Saved policy of a run.

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
        """Return what `reader` returns for the student's name and a copy of the policy in `folder`."""
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
    """Return the saved policy of a run.

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
    """Return the results root that has the run of `saved` (its own root or `results`), or None."""
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
