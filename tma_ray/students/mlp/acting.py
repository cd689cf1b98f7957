"""Forward passes of multilayer perceptrons over numpy arrays. Imports no torch."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.support.jit import kernel

FloatArray: TypeAlias = NDArray[np.float32]
IntArray: TypeAlias = NDArray[np.int64]

RowArrays: TypeAlias = tuple[FloatArray, IntArray, FloatArray, IntArray, bool]
"""The arguments of `apply_row` before the inputs."""


class RowNetwork:
    """A copy of a network's parameters, applied to one input at a time.

    Whoever changes the parameters calls `load` again. Columns of weights behind a ReLU that is zero are
    skipped, which is about half of them.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._weights = np.zeros(layout.parameters, dtype=np.float32)
        self._sizes = np.array(layout.sizes)
        self._work = np.zeros((2, max(layout.sizes)), dtype=np.float32)
        self._active = np.zeros(max(layout.sizes), dtype=np.int64)

    def load(self, parameters: NDArray[np.floating]) -> None:
        """Copy `parameters` (p,)."""
        start = 0
        for outputs, inputs in self._layout.shapes:
            middle, end = start + outputs * inputs, start + outputs * inputs + outputs
            self._weights[start : start + outputs] = parameters[middle:end]
            transposed = self._weights[start + outputs : end].reshape(inputs, outputs)
            transposed[:] = parameters[start:middle].reshape(outputs, inputs).T
            start = end

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the outputs (h,) for `inputs` (i,)."""
        return apply_row(*self.arrays, inputs).copy()

    @property
    def arrays(self) -> RowArrays:
        """The arguments of `apply_row` before the inputs."""
        is_tanh = self._layout.activation is Activation.TANH
        return self._weights, self._sizes, self._work, self._active, is_tanh


@kernel
def apply_row(
    weights: FloatArray,
    sizes: IntArray,
    work: FloatArray,
    active: IntArray,
    is_tanh: bool,
    inputs: FloatArray,
) -> FloatArray:
    """Return the outputs (h,) for `inputs` (i,), in memory that the next call overwrites.

    Args:
        weights: weights of all layers, biases first, each matrix transposed (p,).
        sizes: units of the inputs and of every layer (l,).
        work: overwritten (2, largest size).
        active: overwritten (largest size,).
        is_tanh: True if the activation is the tangent hyperbolic, else it is the ReLU.
        inputs: values (i,).
    """
    source, target = work[0], work[1]
    source[: sizes[0]] = inputs
    start = 0
    for layer in range(len(sizes) - 1):
        rows, columns = sizes[layer], sizes[layer + 1]
        outputs = target[:columns]
        outputs[:] = weights[start : start + columns]
        start += columns
        matrix = weights[start : start + rows * columns].reshape((rows, columns))
        _add_products(matrix, source, active, outputs)
        start += rows * columns
        if layer < len(sizes) - 2:
            for column in range(columns):
                if is_tanh:
                    outputs[column] = math.tanh(outputs[column])
                else:
                    outputs[column] = max(outputs[column], np.float32(0))
        source, target = target, source
    results: FloatArray = source[: sizes[-1]]
    return results


@kernel
def _add_products(matrix: FloatArray, source: FloatArray, active: IntArray, outputs: FloatArray) -> None:
    """Add `source` (r,) times `matrix` (r, c) to `outputs` (c,), four rows at a time and no zero ones."""
    count = 0
    for row in range(len(matrix)):  # without a branch, which could not be predicted
        active[count] = row
        count += source[row] != 0
    for k in range(0, count - 3, 4):
        i0, i1, i2, i3 = active[k], active[k + 1], active[k + 2], active[k + 3]
        x0, x1, x2, x3 = source[i0], source[i1], source[i2], source[i3]
        r0, r1, r2, r3 = matrix[i0], matrix[i1], matrix[i2], matrix[i3]
        for j in range(len(outputs)):
            outputs[j] += (x0 * r0[j] + x1 * r1[j]) + (x2 * r2[j] + x3 * r3[j])
    for k in range(count - count % 4, count):
        x, last = source[active[k]], matrix[active[k]]
        for j in range(len(outputs)):
            outputs[j] += x * last[j]


class ArrayNetwork:
    """A copy of a network's parameters that acts without torch: on one observation or on several.

    Args:
        layout: layout of the network, whose first outputs are the mean actions.
        action_size: number of means a.

    Attributes:
        row: for one observation.
    """

    def __init__(self, layout: Layout, action_size: int) -> None:
        self.layout, self._action_size = layout, action_size
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        self.row = RowNetwork(layout)

    def load(self, parameters: FloatArray) -> None:
        """Load `parameters` (p,), which nobody changes afterwards."""
        parts = np.split(parameters, np.cumsum(self.layout.lengths)[:-1])
        weights = [part.reshape(shape) for part, shape in zip(parts[::2], self.layout.shapes, strict=True)]
        self._layers = list(zip(weights, parts[1::2], strict=True))
        self.row.load(parameters)

    def __call__(self, observations: FloatArray, squash: bool) -> FloatArray:
        """Return the mean actions (n, a) of `observations` (n, o), or their tangent hyperbolic."""
        means = self.outputs(observations)[:, : self._action_size]
        return np.tanh(means) if squash else means

    def outputs(self, observations: FloatArray) -> FloatArray:
        """Return all outputs (n, h) for `observations` (n, o)."""
        if len(observations) == 1:
            return self.row(observations[0])[None]
        values = observations
        for index, (weight, bias) in enumerate(self._layers):
            values = values @ weight.T
            values += bias
            if index < len(self._layers) - 1:
                if self.layout.activation is Activation.TANH:
                    np.tanh(values, out=values)
                else:
                    np.maximum(values, 0, out=values)
        return values
