"""Forward pass of several observations over numpy arrays. Imports no torch."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.rows import RowNetwork

FloatArray: TypeAlias = NDArray[np.float32]


class ArrayNetwork:
    """A copy of a network's parameters that acts without torch: on one observation or on several.

    Args:
        layout: of the network.

    Attributes:
        row: for one observation.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        self.row = RowNetwork(layout)

    def load(self, parameters: FloatArray) -> None:
        """Takes over `parameters` (p,), which nobody changes afterwards."""
        parts = np.split(parameters, np.cumsum(self._layout.lengths)[:-1])
        weights = [part.reshape(shape) for part, shape in zip(parts[::2], self._layout.shapes, strict=True)]
        self._layers = list(zip(weights, parts[1::2], strict=True))
        self.row.load(parameters)

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Returns the outputs (n, h) for `inputs` (n, i)."""
        if len(inputs) == 1:
            return self.row(inputs[0])[None]
        values = inputs
        for index, (weight, bias) in enumerate(self._layers):
            values = values @ weight.T
            values += bias
            if index < len(self._layers) - 1:
                if self._layout.activation is Activation.TANH:
                    np.tanh(values, out=values)
                else:
                    np.maximum(values, 0, out=values)
        return values
