"""Weights of the original's CPPN, from the user's own copy, as the ``.npz`` file that Parkour takes."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.array_files import load_arrays
from tma_ray.importing.errors import ImportRefusedError
from tma_ray.importing.unpickling import load_pickle
from tma_ray.terrain.cppn import CPPN, SHAPES

_CHECKPOINT: Final = (".index", ".meta", ".pb")
_EXPORT: Final = """which only TensorFlow reads. Where that is installed, run
  reader = tf.train.load_checkpoint(PATH)
  names = reader.get_variable_to_shape_map()
  numpy.savez("exported.npz", **{name.replace("/", "_"): reader.get_tensor(name) for name in names})
and import exported.npz"""


def read_weights(path: Path) -> tuple[CPPN, dict[str, str]]:
    """Returns the network of a file, and what each of its matrices is called there.

    The file is a ``.npz``, or a pickle of arrays by name or in order. Five matrices whose names are not
    w1 to w5 are told apart by their shapes, and the three of the same shape by the order of their names.

    Raises:
        ImportRefusedError: no such file, a checkpoint of TensorFlow, or not such matrices.
        RefusedPickleError: a pickle that may not be read.
    """
    if path.is_dir() or path.suffix in _CHECKPOINT or ".data-" in path.name:
        raise ImportRefusedError(f"{path} is a checkpoint of TensorFlow, {_EXPORT}")
    if not path.is_file():
        raise ImportRefusedError(f"no file {path}: give a .npz file or a pickle of the weights")
    arrays = _arrays(path)
    names = _names(path, arrays)
    try:
        network = CPPN({ours: arrays[theirs].astype(np.float32) for ours, theirs in names.items()})
    except ValueError as error:
        raise ImportRefusedError(f"{path}: {error}") from error
    return network, names


def write_weights(network: CPPN, output: Path) -> None:
    """Writes a network as a ``.npz`` file.

    Raises:
        ImportRefusedError: the file is there, or is to end otherwise.
    """
    if output.suffix != ".npz":
        raise ImportRefusedError(f"{output}: weights are a .npz file; choose a name that ends so")
    if output.exists():
        raise ImportRefusedError(f"{output} is there already: choose another name")
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **network.weights)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_bytes(content.getvalue())


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    if zipfile.is_zipfile(path):
        try:
            return _matrices(load_arrays(path))
        except (ValueError, OSError, zipfile.BadZipFile, EOFError) as error:
            raise ImportRefusedError(f"{path} cannot be read ({error}): copy it again") from error
    content = load_pickle(path)
    if isinstance(content, list | tuple):
        content = {f"{place}": each for place, each in enumerate(content)}
    return _matrices(content if isinstance(content, dict) else {})


def _matrices(content: Mapping[Any, Any]) -> dict[str, NDArray[Any]]:
    """Returns the numeric matrices of `content`: the network has no others, and an optimiser may."""
    arrays = {str(name): np.asarray(each) for name, each in content.items() if isinstance(each, np.ndarray)}
    return {name: each for name, each in arrays.items() if each.ndim == 2 and each.dtype.kind == "f"}


def _names(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """Returns the name in the file of each of w1 to w5."""
    if set(SHAPES) <= set(arrays):
        return {name: name for name in SHAPES}
    left = sorted(arrays, key=_in_order)
    found = {}
    for ours, shape in SHAPES.items():
        fitting = [name for name in left if arrays[name].shape == shape]
        if not fitting:
            break
        found[ours] = fitting[0]
        left.remove(fitting[0])
    if len(found) < len(SHAPES) or left:
        wanted = ", ".join(f"{name} {shape}" for name, shape in SHAPES.items())
        told = ", ".join(f"{name[:40]} {each.shape}" for name, each in list(arrays.items())[:10]) or "none"
        raise ImportRefusedError(f"{path} has the matrices {told}; expected five, {wanted}")
    return found


def _in_order(name: str) -> list[tuple[int, str]]:
    """Returns a key that sorts w_2 before w_10, and a name without a number first."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]
