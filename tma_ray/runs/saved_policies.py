"""Policies that runs saved: found by run or folder, copied, loaded."""

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
    """A policy that a run saved.

    Attributes:
        store: store that has it.
        folder: path of its files in the store.
        spec: spec of the run.
    """

    store: Store
    folder: str
    spec: RunSpec

    def copy(self, place: Path) -> None:
        """Copy its files, not those of folders among them, into the existing folder `place`."""
        for path in map(PurePosixPath, self.store.files(self.folder)):
            if path.parent == PurePosixPath(self.folder):
                (place / path.name).write_bytes(self.store.read_bytes(str(path)))

    def read(self, place: Path, reader: Callable[[str, Path], ResultT]) -> ResultT:
        """Return the result of `reader` for the student's name and the copy in `place`."""
        try:
            return reader(self.spec.student, place)
        except PolicyFileError as error:  # which names the copy
            where = self.store.where(f"{self.folder}/{error.file.name}")
            raise PolicyFileError(where, error.problem) from error

    def load(self, observations: spaces.Box, actions: spaces.Box) -> StepPolicy:
        """Return a function from observation to action that acts without exploration.

        Raises:
            PolicyFileError: one of its files is missing, damaged or of another format.
            ValueError: it was trained with another body, or in another environment, than has these spaces.
        """
        with tempfile.TemporaryDirectory() as place:
            self.copy(Path(place))
            policy = self.read(Path(place), load_policy)
        try:
            shape = policy(np.zeros((1, *observations.shape), np.float32)).shape
        except (ValueError, RuntimeError):  # a matrix product of numpy, of torch
            shape = ()
        if shape != (1, *actions.shape):
            raise ValueError(
                f"the policy of {self.spec.run_id} does not fit {observations.shape[0]} observations and "
                f"{actions.shape[0]} actions; it was trained in {self.spec.environment} with "
                f"{self.spec.embodiment or 'no body'}"
            )
        return lambda observation: policy(observation[None])[0]


def find_policy(name: str, results: str | Path) -> SavedPolicy:
    """Return the policy called `name`.

    Args:
        name: folder of a saved policy or a file in it; else a run of `results`: its id, or the beginning
            of that of no other run.
        results: folder or URI of a results root.

    Raises:
        ValueError: the policy does not exist, or several runs could be meant.
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
        found = Results.open(results)
    except ResultsRootError as error:
        raise ValueError(f"no policy {name!r}: it is not a folder, and {error}") from error
    saved = _in_folder(found.store, policy_folder(found.find(name).run.run_id))
    fetch(found.store, saved.spec)
    return saved


def results_of(saved: SavedPolicy, results: str | Path) -> Results | None:
    """Return the results of the run of `saved`, of its own root or `results`; None if neither has them."""
    folder = Path(saved.store.where(saved.folder))
    beside = not saved.store.is_object_store and folder.parent.name == POLICIES
    for root in [folder.parent.parent, results] if beside else [results]:
        try:
            found = Results.open(root)
        except ResultsRootError:
            continue
        if any(manifest.run.run_id == saved.spec.run_id for manifest in found.runs()):
            return found
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
