"""Networks mirrored into one plain array, for acting on one observation without a framework's overhead."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations
from tma_ray.students.perceptron import Blocks

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int64]


class Mirror:
    """A copy of linear layers with ReLUs between, applied to one input.

    It is a copy: whoever changes the layers calls `refresh`. Columns of weights behind a ReLU that is
    zero are skipped, which is about half of them.

    Args:
        blocks: the layers in order; those of a block share their inputs, and their outputs follow one
            another.
    """

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        sizes = [blocks[0][0].in_features]
        sizes += [sum(layer.out_features for layer in block) for block in blocks]
        self._sizes = np.array(sizes)
        self._work = np.zeros((2, max(sizes)), dtype=np.float32)
        self._active = np.zeros(max(sizes), dtype=np.int64)
        self.refresh()

    def refresh(self) -> None:
        """Takes over the layers' present parameters."""
        parts: list[torch.Tensor] = []
        with torch.no_grad():
            for block in self._blocks:
                parts += [layer.bias for layer in block]
                weights: list[torch.Tensor] = [layer.weight for layer in block]
                parts.append(torch.cat(weights).t().reshape(-1))
            self._weights: FloatArray = torch.cat(parts).numpy(force=True)

    def __call__(self, inputs: Observations) -> FloatArray:
        """Returns the last block's outputs (h,) for `inputs` (i,)."""
        return apply(*self.arrays, inputs).copy()

    @property
    def arrays(self) -> tuple[FloatArray, IntArray, FloatArray, IntArray]:
        """Arrays that `apply` takes before the inputs."""
        return self._weights, self._sizes, self._work, self._active

    def sample_squashed(
        self, inputs: Observations, noise: FloatArray, log_range: tuple[float, float]
    ) -> Actions:
        """Returns the tangent hyperbolic of a normal variable, whose outputs are means and log deviations.

        Args:
            inputs: (i,).
            noise: standard normal (a,).
            log_range: bounds of the log deviation.
        """
        outputs = apply(*self.arrays, inputs)
        return _squashed(outputs, noise, *log_range)


@kernel
def apply(
    weights: FloatArray, sizes: IntArray, work: FloatArray, active: IntArray, inputs: Observations
) -> FloatArray:
    """Returns the outputs (h,) for `inputs` (i,), in memory that the next call overwrites.

    Args:
        weights: of all layers, biases first, each matrix transposed.
        sizes: units of the inputs and of every layer (l,).
        work: overwritten (2, largest size).
        active: overwritten (largest size,).
        inputs: (i,).
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
                outputs[column] = max(outputs[column], np.float32(0))
        source, target = target, source
    results: FloatArray = source[: sizes[-1]]
    return results


@kernel
def _add_products(matrix: FloatArray, source: FloatArray, active: IntArray, outputs: FloatArray) -> None:
    """Adds `source` (r,) times `matrix` (r, c) to `outputs` (c,), four rows at a time and no zero ones."""
    count = 0
    for row in range(len(matrix)):  # without a branch, which nobody could predict
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


@kernel
def _squashed(outputs: FloatArray, noise: FloatArray, lowest: float, highest: float) -> Actions:
    count = len(noise)
    actions = np.empty_like(noise)
    for k in range(count):
        deviation = np.exp(min(max(outputs[count + k], np.float32(lowest)), np.float32(highest)))
        actions[k] = np.tanh(outputs[k] + deviation * noise[k])
    return actions
