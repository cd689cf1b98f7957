"""Saved policies (``policy.json`` and ``policy.safetensors``), safe to read from any source."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, NoReturn, TypeAlias, TypeVar

import msgspec
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as parse_tensors
from safetensors.numpy import save as serialise_tensors

from tma_ray.support.decoding import DamagedFileError, decode_json, read_file

ContentT = TypeVar("ContentT")

FORMAT_VERSION: Final = 1  # increased when names or meanings of saved values change

POLICY_FILE: Final = "policy.json"
TENSORS_FILE: Final = "policy.safetensors"

_MAX_FLOAT32: Final = float(np.finfo(np.float32).max)

_ADVICE: Final = "copy the whole folder again, or run its spec again on a new results root"

Bound: TypeAlias = Annotated[float, msgspec.Meta(ge=-_MAX_FLOAT32, le=_MAX_FLOAT32)] | None
"""Bound of one dimension of a space, None for an infinite one (JSON has no infinity)."""


@dataclass(frozen=True)
class _Version:
    """Fields common to all format versions of `POLICY_FILE`."""

    format_version: int


@dataclass(frozen=True)
class _Bounds:
    """Bounds of the dimensions of a space."""

    low: Annotated[tuple[Bound, ...], msgspec.Meta(min_length=1)]
    high: Annotated[tuple[Bound, ...], msgspec.Meta(min_length=1)]


@dataclass(frozen=True)
class _Settings:
    """Fields of `POLICY_FILE` other than the version."""

    student: str
    observation_space: _Bounds
    action_space: _Bounds
    hyperparameters: dict[str, Any]


class PolicyFileError(ValueError):
    """Error raised if a saved policy cannot be read; it names the file, the problem and a remedy."""

    def __init__(self, file: str | Path, problem: str) -> None:
        super().__init__(f"{file}: {problem}")
        self.file, self.problem = Path(file), problem


@dataclass(frozen=True)
class StoredPolicy:
    """Content of a saved policy, as read by `read_policy`.

    Attributes:
        folder: folder of the policy.
        observation_space: observation space of the training environment (o,).
        action_space: action space of the training environment (a,).
        hyperparameters: hyper-parameters that shape the policy.
        tensors: arrays by name.
    """

    folder: Path
    observation_space: spaces.Box
    action_space: spaces.Box
    hyperparameters: Mapping[str, Any]
    tensors: Mapping[str, NDArray[Any]]

    def check(self, expected: Mapping[str, tuple[tuple[int, ...], str]]) -> None:
        """Check that the tensors are those in `expected`, which maps names to shapes and numpy types.

        Raises:
            PolicyFileError: if a tensor is missing, unknown, or of another shape or type.
        """
        for name, (shape, kind) in expected.items():
            if name not in self.tensors:
                self.refuse_tensors(f"tensor {name!r} is missing")
            tensor = self.tensors[name]
            if tensor.shape != tuple(shape) or tensor.dtype != np.dtype(kind):
                self.refuse_tensors(
                    f"tensor {name!r} is {tensor.dtype} {tensor.shape}, expected {kind} {tuple(shape)}"
                )
        for name in sorted(self.tensors.keys() - expected.keys()):
            self.refuse_tensors(f"tensor {name!r} does not belong to the policy")

    def refuse_tensors(self, problem: str) -> NoReturn:
        """Raise a `PolicyFileError` about the tensors."""
        raise PolicyFileError(self.folder / TENSORS_FILE, f"{problem}; {_ADVICE}")

    def refuse(self, problem: str) -> NoReturn:
        """Raise a `PolicyFileError` about `POLICY_FILE`."""
        raise PolicyFileError(self.folder / POLICY_FILE, f"{problem}; {_ADVICE}")


def write_policy(
    folder: Path,
    student: str,
    observation_space: spaces.Box,
    action_space: spaces.Box,
    tensors: Mapping[str, NDArray[Any]],
    hyperparameters: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy to the existing `folder`; equal policies have equal bytes.

    Args:
        folder: folder of the policy alone.
        student: name of the kind of policy, which `read_policy` checks.
        observation_space: a one-dimensional float32 box.
        action_space: a one-dimensional float32 box.
        tensors: learned arrays that acting needs, by name.
        hyperparameters: JSON values that shape the policy.
    """
    content = {
        "format_version": FORMAT_VERSION,
        "student": student,
        "observation_space": _bounds(observation_space),
        "action_space": _bounds(action_space),
        "hyperparameters": dict(hyperparameters or {}),
    }
    # C order, since safetensors ignores strides
    ordered = {name: np.asarray(tensor, order="C") for name, tensor in tensors.items()}
    (folder / TENSORS_FILE).write_bytes(serialise_tensors(ordered))
    (folder / POLICY_FILE).write_text(json.dumps(content, indent=1) + "\n")


def read_policy(folder: Path, student: str) -> StoredPolicy:
    """Read a policy written by `write_policy`; the caller must check its tensors with `StoredPolicy.check`.

    Raises:
        PolicyFileError: if a file is missing, damaged, of another format version or of another student.
    """
    path = folder / POLICY_FILE
    data = _bytes(path)
    version = _decoded(path, data, _Version).format_version
    if version != FORMAT_VERSION:
        raise PolicyFileError(
            path,
            f"format_version is {version}, this tma_ray reads {FORMAT_VERSION}; "
            f"load it with the tma_ray that saved it, or run its spec again",
        )
    settings = _decoded(path, data, _Settings)
    if settings.student != student:
        raise PolicyFileError(
            path, f"a policy of student {settings.student!r:.80}, not of {student!r}; name its student"
        )
    observation_space = _box(path, settings.observation_space, "observation_space")
    action_space = _box(path, settings.action_space, "action_space")
    path = folder / TENSORS_FILE
    try:
        stored = parse_tensors(_bytes(path))
    except (SafetensorError, KeyError, TypeError) as error:  # KeyError for a type that numpy lacks
        raise PolicyFileError(path, f"no sound safetensors file ({error}); {_ADVICE}") from error
    tensors = {  # copied to be aligned and writable; released policies store float16
        name: np.array(tensor, np.float32 if tensor.dtype == np.float16 else tensor.dtype)
        for name, tensor in stored.items()
    }
    return StoredPolicy(folder, observation_space, action_space, settings.hyperparameters, tensors)


def _decoded(path: Path, data: bytes, kind: type[ContentT]) -> ContentT:
    try:
        return decode_json(data, kind, str(path))
    except DamagedFileError as error:
        problem = str(error).removeprefix(f"{path} is ")
        raise PolicyFileError(path, f"{problem}; {_ADVICE}") from error


def _bytes(path: Path) -> bytes:
    if not path.is_file():
        problem = f"the file does not exist; a saved policy is {POLICY_FILE} and {TENSORS_FILE}: {_ADVICE}"
        raise PolicyFileError(path, problem)
    return read_file(path)


def _bounds(space: spaces.Box) -> dict[str, list[float | None]]:
    """Return the bounds of all dimensions, with None for infinite ones (JSON has no infinity)."""
    return {
        name: [float(value) if math.isfinite(value) else None for value in bounds]
        for name, bounds in (("low", space.low), ("high", space.high))
    }


def _box(path: Path, bounds: _Bounds, name: str) -> spaces.Box:
    low = np.array([-np.inf if value is None else value for value in bounds.low], np.float32)
    high = np.array([np.inf if value is None else value for value in bounds.high], np.float32)
    if low.shape != high.shape or (low > high).any():
        problem = f"{name}: expected as many numbers low as high, and none over it"
        raise PolicyFileError(path, f"{problem}; {_ADVICE}")
    return spaces.Box(low, high, dtype=np.float32)
