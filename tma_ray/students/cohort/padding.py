"""Flat parameters padded to sizes that a GPU multiplies fast, and back.

Rows of 300 bfloat16 values are not a multiple of 16 bytes, and products of such matrices take four times as
long. Weights and biases of padding are 0 and stay so: a hidden unit of padding is 0 under any activation and
gets no gradient, and inputs of padding are 0. On a CPU the padding makes sure that the parameters of all runs
are aligned alike, so that they are multiplied by the same instructions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Layout

INPUTS_MULTIPLE = 8
HIDDEN_MULTIPLE = 16


class PaddedLayout(NamedTuple):
    """A layout of which inputs and hidden layers are padded; outputs are not.

    Attributes:
        plain: without padding.
        padded: with padding.
        others: number of parameters that follow the network's.
    """

    plain: Layout
    padded: Layout
    others: int = 0

    @classmethod
    def of(cls, plain: Layout, others: int = 0) -> PaddedLayout:
        """Returns the padding of `plain`, after whose parameters there are `others`."""
        inputs, *hidden, outputs = plain.sizes
        sizes = [_up(inputs, INPUTS_MULTIPLE), *(_up(size, HIDDEN_MULTIPLE) for size in hidden), outputs]
        return cls(plain, Layout(tuple(sizes), plain.activation), others)

    @property
    def length(self) -> int:
        """Number of parameters with padding, at the end too."""
        return _up(self.padded.parameters + self.others, HIDDEN_MULTIPLE)

    def places(self) -> NDArray[np.int64]:
        """Returns where each parameter of the plain vector (p,) lies in the padded one."""
        parts, start = [], 0
        for plain, padded in zip(self.plain.shapes, self.padded.shapes, strict=True):
            weights = np.arange(start, start + padded.outputs * padded.inputs).reshape(padded)
            start += weights.size
            parts += [
                weights[: plain.outputs, : plain.inputs].ravel(),
                np.arange(start, start + plain.outputs),
            ]
            start += padded.outputs
        return np.concatenate([*parts, np.arange(start, start + self.others)])

    def inputs(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns `inputs` (..., i) with zeros behind, as many as are missing."""
        missing = self.padded.sizes[0] - inputs.shape[-1]
        return torch.nn.functional.pad(inputs, (0, missing)) if missing else inputs


def _up(size: int, multiple: int) -> int:
    return -(-size // multiple) * multiple
