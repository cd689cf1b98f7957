"""Layout of a multilayer perceptron in a flat vector of parameters."""

from __future__ import annotations

import itertools
from typing import NamedTuple


class Shape(NamedTuple):
    """Size of one linear layer.

    Attributes:
        outputs: units of the layer.
        inputs: units of what it is applied to.
    """

    outputs: int
    inputs: int


class Layout(NamedTuple):
    """Sizes of linear layers with a ReLU after each but the last, whose parameters lie in one vector (p,).

    Layer by layer: its weight (outputs, inputs), row by row, and its bias (outputs,). Several runs' or
    several networks' vectors may be stacked to (k, p).

    Attributes:
        sizes: units of the inputs and of every layer.
    """

    sizes: tuple[int, ...]

    @property
    def shapes(self) -> list[Shape]:
        """Sizes of the layers in order."""
        return [Shape(outputs, inputs) for inputs, outputs in itertools.pairwise(self.sizes)]

    @property
    def lengths(self) -> list[int]:
        """Number of parameters of each weight and each bias, in order."""
        return [length for outputs, inputs in self.shapes for length in (outputs * inputs, outputs)]

    @property
    def parameters(self) -> int:
        """Number of parameters p."""
        return sum(self.lengths)
