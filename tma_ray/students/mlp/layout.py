"""Layout of a multilayer perceptron in a flat vector of parameters, importable without torch or numba."""

import itertools
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Activation(StrEnum):
    """Activation after every linear layer except the last."""

    RELU = "relu"
    TANH = "tanh"


class Layout(NamedTuple):
    """Sizes and activation of a multilayer perceptron whose parameters are one vector (p,).

    The vector holds the weight (outputs, inputs) and the bias (outputs,) of each layer in order. Vectors of
    several networks may be stacked to (k, p).

    Attributes:
        sizes: units of the inputs and of every layer.
        activation: activation after each layer but the last.
    """

    sizes: tuple[int, ...]
    activation: Activation = Activation.RELU

    @property
    def shapes(self) -> list[tuple[int, int]]:
        """Shape (outputs, inputs) of each weight matrix."""
        return [(outputs, inputs) for inputs, outputs in itertools.pairwise(self.sizes)]

    @property
    def lengths(self) -> list[int]:
        """Number of parameters in each weight matrix and bias, in the order of the vector."""
        return [length for outputs, inputs in self.shapes for length in (outputs * inputs, outputs)]

    @property
    def parameters(self) -> int:
        """Number of parameters p."""
        return sum(self.lengths)

    def trunks(self, first: int) -> NDArray[np.bool_]:
        """Return a parameter mask (p,) that splits the network in two, with half of the hidden units each.

        Args:
            first: number of outputs of the first network.
        """
        masks = []
        for index, (outputs, inputs) in enumerate(self.shapes):
            mask = np.ones((outputs, inputs), dtype=np.bool_)
            if index:
                half = first if index == len(self.sizes) - 2 else outputs // 2
                mask[:half, inputs // 2 :] = mask[half:, : inputs // 2] = False
            masks += [mask.ravel(), np.ones(outputs, dtype=np.bool_)]
        return np.concatenate(masks)
