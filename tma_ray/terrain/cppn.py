"""The network that draws Parkour's ground and ceiling (paper, appendix B, CPPN-encoded terrain)."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.array_files import load_arrays

POINTS = 200
"""Points of a curve; the network's x runs from 0 to 1 over them."""

INPUTS = 3
"""Size of theta, the part of a task that chooses the curves."""

UNITS = 64
"""Units of each of the four hidden layers."""

SHAPES = {
    "w1": (1 + INPUTS, UNITS),
    "w2": (UNITS, UNITS),
    "w3": (UNITS, UNITS),
    "w4": (UNITS, UNITS),
    "w5": (UNITS, 2),
}
"""Names and shapes of the weight matrices, from the input [x, theta] to the output [ground, ceiling]."""

BLOCK = 50
"""Points that pass the network together: too few for BLAS to spread over threads, which for so small products
takes longer, and so the same bits with any number of threads."""

DEFAULT_WEIGHTS = Path(__file__).parent / "data" / "cppn.npz"
"""Weights shipped with the package, found by docs/making/search_cppn_weights.py."""

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CPPN:
    """A compositional pattern-producing network with fixed weights.

    Four hidden layers, tanh and softplus in turn, a linear output, no biases; all in float32. Its outputs
    are heights before they are scaled and aligned to the start.

    Source: paper, appendix B. It draws weights from N(0, 1), the original release from a normal
    distribution of standard deviation 2 cut at two standard deviations.

    Attributes:
        weights: float32 matrices by name, of `SHAPES`.
    """

    weights: Mapping[str, Singles]

    def __post_init__(self) -> None:
        for name, shape in SHAPES.items():
            if name not in self.weights:
                raise ValueError(f"weights {name!r} are missing: expected {', '.join(SHAPES)}")
            matrix = self.weights[name]
            if matrix.shape != shape or not np.all(np.isfinite(matrix)):
                raise ValueError(
                    f"weights {name!r} of shape {matrix.shape}: expected finite numbers of shape {shape}"
                )

    @classmethod
    def load(cls, path: str | Path = DEFAULT_WEIGHTS) -> CPPN:
        """Returns the network whose weights are the arrays w1 to w5 of a ``.npz`` file; others are ignored.

        Raises:
            ValueError: no such file, no such arrays in it, or of other shapes.
        """
        try:
            arrays = load_arrays(Path(path))
            return cls({name: arrays[name].astype(np.float32) for name in SHAPES if name in arrays})
        except FileNotFoundError as error:
            raise ValueError(f"no file of CPPN weights {str(path)!r}") from error
        except (zipfile.BadZipFile, EOFError, AttributeError, TypeError) as error:
            raise ValueError(f"{path} is not an .npz file of CPPN weights") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    def curves(self, theta: ArrayLike) -> Singles:
        """Returns ground and ceiling for `theta` (..., 3): heights (..., 200, 2), not scaled or aligned."""
        values = np.asarray(theta, dtype=np.float32)
        w1, w2, w3, w4, w5 = (self.weights[name] for name in SHAPES)
        signal: Singles = self._from_x + (values @ w1[1:])[..., None, None, :]
        np.tanh(signal, out=signal)
        signal = softplus(signal @ w2)
        signal = signal @ w3
        np.tanh(signal, out=signal)
        curves: Singles = softplus(signal @ w4) @ w5
        return curves.reshape(*values.shape[:-1], POINTS, 2)

    @cached_property
    def _from_x(self) -> Singles:
        """Contribution of x, alike in all tasks, to the first layer (blocks, 50, 64)."""
        x = np.arange(POINTS, dtype=np.float32) / np.float32(POINTS - 1)
        return np.outer(x, self.weights["w1"][0]).reshape(-1, BLOCK, UNITS)


def softplus(values: Singles) -> Singles:
    """Returns log(1 + exp(values)), exact to float32's resolution at 1, without overflow."""
    result = np.exp(-np.abs(values))
    result += np.float32(1)
    np.log(result, out=result)
    result += np.maximum(values, np.float32(0))
    return result
