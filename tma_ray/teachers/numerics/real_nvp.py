"""A conditional RNVP flow: points of the unit box from Gaussian noise, with their exact density."""

from __future__ import annotations

import math

import torch
from torch import nn
from torch.nn.functional import logsigmoid

from tma_ray.teachers.numerics.networks import linear

DTYPE = torch.float64
"""Scales of all couplings multiply, which is too much for the inverse in single precision."""

BLOCKS = 3
GATED_LAYERS = 3
SMALLEST_SCALE = 0.01

UNIT_SCALE_INPUT = 0.9131652918237967
"""Where `SMALLEST_SCALE` + `slow_softplus` is 1."""

MARGIN = 1e-4
"""Points keep this distance from the faces of the box, where the density of a sigmoid diverges."""


class HighwayNetwork(nn.Module):
    """Maps (n, inputs) to (n, outputs) by a tanh layer, three gated tanh layers and a linear one.

    A gated layer mixes its input with a tanh layer of it (Srivastava et al. 2015). Before any training
    every output is `start`.
    """

    def __init__(
        self, inputs: int, hidden: int, outputs: int, start: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self._first = linear(inputs, hidden, DTYPE, generator)
        self._gates = nn.ModuleList(linear(hidden, hidden, DTYPE, generator) for _ in range(GATED_LAYERS))
        self._layers = nn.ModuleList(linear(hidden, hidden, DTYPE, generator) for _ in range(GATED_LAYERS))
        self._last = linear(hidden, outputs, DTYPE, generator)
        nn.init.zeros_(self._last.weight)
        nn.init.constant_(self._last.bias, start)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns (n, outputs)."""
        hidden = torch.tanh(self._first(inputs))
        for gate, layer in zip(self._gates, self._layers, strict=True):
            hidden = torch.lerp(hidden, torch.tanh(layer(hidden)), torch.sigmoid(gate(hidden)))
        outputs: torch.Tensor = self._last(hidden)
        return outputs


class AffineCoupling(nn.Module):
    """Scales and shifts some coordinates by functions of the others and of a condition.

    Before any training it is the identity. (With weights around 0, as they usually begin, each of the
    couplings would shrink to a third, all of them together to nearly a point.)

    Args:
        moved: bool (d,), the coordinates that change.
        hidden: units of each layer of both networks.
        generator: draws the initial weights.
    """

    def __init__(self, moved: torch.Tensor, hidden: int, generator: torch.Generator) -> None:
        super().__init__()
        self._moved = moved
        outputs = int(moved.sum())
        inputs = len(moved) - outputs + 1
        self._scale_network = HighwayNetwork(inputs, hidden, outputs, UNIT_SCALE_INPUT, generator)
        self._shift_network = HighwayNetwork(inputs, hidden, outputs, 0.0, generator)

    def forward(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns new points (n, d) and the log-determinant (n,) of the Jacobian."""
        scale, shift = self._scale_and_shift(points, condition)
        return self._replaced(points, points[:, self._moved] * scale + shift), scale.log().sum(dim=1)

    def inverse(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns what leads to `points` (n, d), and the log-determinant (n,) of `forward` there."""
        scale, shift = self._scale_and_shift(points, condition)
        return self._replaced(points, (points[:, self._moved] - shift) / scale), scale.log().sum(dim=1)

    def _scale_and_shift(
        self, points: torch.Tensor, condition: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        inputs = torch.cat([points[:, ~self._moved], condition[:, None]], dim=1)
        return SMALLEST_SCALE + slow_softplus(self._scale_network(inputs)), self._shift_network(inputs)

    def _replaced(self, points: torch.Tensor, moved: torch.Tensor) -> torch.Tensor:
        replaced = points.clone()
        replaced[:, self._moved] = moved
        return replaced


class RealNVP(nn.Module):
    """A density over the unit box for every condition in (0, 1).

    Sources: Dinh et al. 2017 (couplings), Racaniere et al. 2020, appendix (three blocks of three
    couplings: by halves, by the other halves, interlaced); scales, highway networks and precision as
    in the original release. Its sigmoid is clipped as the paper says, and so is the density here.

    Args:
        size: dimensions d; a single one depends on the condition alone.
        hidden: units of each hidden layer (paper: n_HIDDEN).
        generator: draws the initial weights.
    """

    def __init__(self, size: int, hidden: int, generator: torch.Generator) -> None:
        super().__init__()
        self.size = size
        index = torch.arange(size)
        parts = [index >= size // 2, index < size // 2, index % 2 == 1]
        if size == 1:
            parts = [torch.tensor([True])] * len(parts)
        self._couplings = nn.ModuleList(
            AffineCoupling(moved, hidden, generator) for _ in range(BLOCKS) for moved in parts
        )

    def forward(self, latents: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the points (n, d) of `latents` (n, d) and their log-density (n,) under `condition` (n,)."""
        points, log_density = latents, _standard_log_density(latents)
        for coupling in self._couplings:
            points, log_determinant = coupling(points, condition)
            log_density = log_density - log_determinant
        clipped = points.clamp(-_LIMIT, _LIMIT)
        return torch.sigmoid(clipped), log_density - _log_slope(clipped)

    def inverse(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the latents (n, d) of `points` (n, d), `MARGIN` inside, and their log-density (n,)."""
        latents = torch.logit(points.clamp(MARGIN, 1 - MARGIN))
        log_density = -_log_slope(latents)
        for coupling in reversed(self._couplings):
            assert isinstance(coupling, AffineCoupling)
            latents, log_determinant = coupling.inverse(latents, condition)
            log_density = log_density - log_determinant
        return latents, log_density + _standard_log_density(latents)


_LIMIT = math.log((1 - MARGIN) / MARGIN)


def slow_softplus(inputs: torch.Tensor) -> torch.Tensor:
    """Returns a positive function that is near max(0, x) but leaves 0 slowly: x (atan(x)/pi + 1/2) + 1/pi."""
    return inputs * (torch.atan(inputs) / math.pi + 0.5) + 1 / math.pi


def _standard_log_density(points: torch.Tensor) -> torch.Tensor:
    return -0.5 * (points**2 + math.log(2 * math.pi)).sum(dim=1)


def _log_slope(points: torch.Tensor) -> torch.Tensor:
    """Returns the log-determinant (n,) of the sigmoid's Jacobian at `points` (n, d)."""
    return (logsigmoid(points) + logsigmoid(-points)).sum(dim=1)
