"""Forward passes of multilayer perceptrons over numpy arrays, importable without torch."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.support.jit import kernel

FloatArray: TypeAlias = NDArray[np.float32]
IntArray: TypeAlias = NDArray[np.int64]

RowArrays: TypeAlias = tuple[FloatArray, IntArray, FloatArray, IntArray, bool]
"""Arguments of `apply_row` other than the inputs."""


class RowNetwork:
    """Multilayer perceptron for single inputs (i,), with its own copy of the parameters.

    Weights that multiply the zeros of inactive ReLUs, about half of them, are skipped.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._weights = np.zeros(layout.parameters, dtype=np.float32)
        self._sizes = np.array(layout.sizes)
        self._work = np.zeros((2, max(layout.sizes)), dtype=np.float32)
        self._active = np.zeros(max(layout.sizes), dtype=np.int64)

    def load(self, parameters: NDArray[np.floating]) -> None:
        """Load a copy of `parameters` (p,)."""
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
        """Arguments of `apply_row` other than the inputs."""
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
        weights: biases and transposed weight matrix of each layer in order (p,).
        sizes: units of the inputs and of every layer (l,).
        work: scratch memory (2, largest size).
        active: scratch memory (largest size,).
        is_tanh: True for tanh activations, False for ReLUs.
        inputs: inputs (i,).
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
    """Add `source` (r,) times `matrix` (r, c) to `outputs` (c,), four nonzero rows at a time."""
    count = 0
    for row in range(len(matrix)):  # branchless, since an if would often be mispredicted
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
    """Multilayer perceptron in numpy, whose first outputs are mean actions.

    Single observations use `row`.
    """

    def __init__(self, layout: Layout, action_size: int) -> None:
        self.layout, self._action_size = layout, action_size
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        self.row = RowNetwork(layout)

    def load(self, parameters: FloatArray) -> None:
        """Load `parameters` (p,), which must not be changed afterwards."""
        vectors = np.split(parameters, np.cumsum(self.layout.lengths)[:-1])
        shapes = zip(vectors[::2], self.layout.shapes, strict=True)
        self._layers = list(zip([flat.reshape(shape) for flat, shape in shapes], vectors[1::2], strict=True))
        self.row.load(parameters)

    def __call__(self, observations: FloatArray, squash: bool) -> FloatArray:
        """Return the mean actions (n, a) for `observations` (n, o), squashed by tanh if `squash`."""
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
