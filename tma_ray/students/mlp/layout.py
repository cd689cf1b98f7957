"""Layout of a multilayer perceptron in a flat vector of parameters. Imports neither torch nor numba."""

import itertools
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Activation(StrEnum):
    """Function that follows each linear layer but the last.

    Attributes:
        RELU: the larger of 0 and its argument.
        TANH: the tangent hyperbolic.
    """

    RELU = "relu"
    TANH = "tanh"


class Layout(NamedTuple):
    """Sizes of linear layers with an activation after each but the last; their parameters are a vector (p,).

    Layer by layer: its weight (outputs, inputs), row by row, and its bias (outputs,). Several runs' or
    several networks' vectors may be stacked to (k, p).

    Attributes:
        sizes: units of the inputs and of every layer.
        activation: function after each layer but the last.
    """

    sizes: tuple[int, ...]
    activation: Activation = Activation.RELU

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """Outputs and inputs of each layer, in order."""
        return [(outputs, inputs) for inputs, outputs in itertools.pairwise(self.sizes)]

    @property
    def lengths(self) -> list[int]:
        """Number of parameters of each weight and each bias, in order."""
        return [length for outputs, inputs in self.shapes for length in (outputs * inputs, outputs)]

    @property
    def parameters(self) -> int:
        """Number of parameters p."""
        return sum(self.lengths)

    def trunks(self, first: int) -> NDArray[np.bool_]:
        """Return the parameters (p,) that remain where two networks side by side share nothing but inputs.

        Each has half of every hidden layer.

        Args:
            first: number of outputs of the first network; the others are the second's.
        """
        parts = []
        for index, (outputs, inputs) in enumerate(self.shapes):
            kept = np.ones((outputs, inputs), dtype=np.bool_)
            if index:
                own = first if index == len(self.sizes) - 2 else outputs // 2
                kept[:own, inputs // 2 :] = kept[own:, : inputs // 2] = False
            parts += [kept.ravel(), np.ones(outputs, dtype=np.bool_)]
        return np.concatenate(parts)
