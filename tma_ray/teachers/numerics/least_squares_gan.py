"""The generative adversarial network of Goal-GAN."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tma_ray.teachers.numerics.networks import descend, inference, linear, torch_generator, training

GENERATOR_UNITS = 256
DISCRIMINATOR_UNITS = 128
LEAK = 0.1

SMOOTHING = 0.9
"""Share of the mean square of gradients that RMSProp keeps at a step: the default of TensorFlow 1, which the
original release ran with; torch's is 0.99."""


class LeastSquaresGAN:
    """A generator of points in [-1, 1] and a discriminator that tells wanted points from others.

    Source: Florensa et al. 2018, section 4.2, after Mao et al. 2017: the discriminator is drawn to +1 on
    wanted and to -1 on unwanted and on generated points, the generator to where it is +1.
    Layers as in TeachMyAgent's paper, appendix A; initial weights, leaky units of the discriminator
    and optimisers as in its release.

    Args:
        size: dimensions d of points and of the noise that they are generated from.
        learning_rate: of both RMSProp optimisers.
        batch_size: points per step, and as many generated ones.
        rng: draws the initial weights.
    """

    def __init__(self, size: int, learning_rate: float, batch_size: int, rng: np.random.Generator) -> None:
        seeded = torch_generator(rng)

        def layer(inputs: int, outputs: int) -> nn.Linear:
            return linear(inputs, outputs, torch.float32, seeded)

        wide, narrow = GENERATOR_UNITS, DISCRIMINATOR_UNITS
        self.generator = nn.Sequential(
            layer(size, wide), nn.ReLU(), layer(wide, wide), nn.ReLU(), layer(wide, size), nn.Tanh()
        )
        self.discriminator = nn.Sequential(
            layer(size, narrow),
            nn.LeakyReLU(LEAK),
            layer(narrow, narrow),
            nn.LeakyReLU(LEAK),
            layer(narrow, 1),
        )
        self._size, self._batch_size = size, batch_size
        self._generator_optimiser, self._discriminator_optimiser = (
            torch.optim.RMSprop(network.parameters(), learning_rate, alpha=SMOOTHING)
            for network in (self.generator, self.discriminator)
        )

    def generate(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Returns `count` points (count, d) in [-1, 1]."""
        with inference():
            points: NDArray[np.float32] = self.generator(self._noise(count, rng)).numpy()
        return points.astype(np.float64)

    def train(
        self,
        points: NDArray[np.float64],
        wanted: NDArray[np.bool_],
        iterations: int,
        rng: np.random.Generator,
    ) -> dict[str, float]:
        """Takes one step of each network per iteration.

        Args:
            points: (n, d).
            wanted: label (n,) of each.
            iterations: number of steps.
            rng: draws batches and noise.

        Returns:
            Mean losses of the steps by name.
        """
        inputs = torch.from_numpy(points.astype(np.float32))
        targets = torch.from_numpy(np.where(wanted, 1.0, -1.0).astype(np.float32))[:, None]
        losses = np.empty((iterations, 2))
        with training():
            for iteration in range(iterations):
                batch = torch.from_numpy(rng.integers(len(points), size=self._batch_size))
                losses[iteration] = self._step(inputs[batch], targets[batch], rng)
        discriminator_loss, generator_loss = losses.mean(axis=0).tolist()
        return {"discriminator_loss": discriminator_loss, "generator_loss": generator_loss}

    def _step(
        self, points: torch.Tensor, targets: torch.Tensor, rng: np.random.Generator
    ) -> tuple[float, float]:
        generated = self.generator(self._noise(self._batch_size, rng))
        judged = self.discriminator(torch.cat([points, generated.detach()]))
        aims = torch.cat([targets, torch.full_like(targets, -1.0)])
        discriminator_loss = nn.functional.mse_loss(judged, aims)
        descend(self._discriminator_optimiser, discriminator_loss)
        self.discriminator.requires_grad_(False)
        generator_loss = ((self.discriminator(generated) - 1) ** 2).mean()
        descend(self._generator_optimiser, generator_loss)
        self.discriminator.requires_grad_(True)
        return discriminator_loss.item(), generator_loss.item()

    def _noise(self, count: int, rng: np.random.Generator) -> torch.Tensor:
        return torch.from_numpy(rng.standard_normal((count, self._size), dtype=np.float32))
