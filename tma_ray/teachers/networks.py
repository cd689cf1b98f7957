"""Neural networks of Goal-GAN and Setter-Solver, the only teachers that import torch."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import logsigmoid

from tma_ray.support.import_hacks import skip_dynamo, take_step

skip_dynamo()


def torch_generator(rng: np.random.Generator) -> torch.Generator:
    """Return a torch generator seeded by a draw from `rng`."""
    return torch.Generator().manual_seed(int(rng.integers(2**63)))


def linear(inputs: int, outputs: int, dtype: torch.dtype, generator: torch.Generator) -> nn.Linear:
    """Return a layer with uniform Xavier weights (Glorot and Bengio 2010) and zero bias."""
    layer = nn.Linear(inputs, outputs, device="meta", dtype=dtype)  # skips the default initialisation
    layer.weight, layer.bias = (
        nn.Parameter(torch.empty(parameter.shape, dtype=dtype)) for parameter in (layer.weight, layer.bias)
    )
    nn.init.xavier_uniform_(layer.weight, generator=generator)
    nn.init.zeros_(layer.bias)
    return layer


def descend(optimiser: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    """Take one step of `optimiser` to reduce `loss`."""
    for group in optimiser.param_groups:
        for parameter in group["params"]:
            parameter.grad = None
    loss.backward()  # type: ignore[no-untyped-call]
    take_step(optimiser)


@contextmanager
def single_thread() -> Iterator[None]:
    """Context manager that limits torch to one thread, for bitwise reproducibility."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


GENERATOR_UNITS = 256
DISCRIMINATOR_UNITS = 128
LEAK = 0.1

SMOOTHING = 0.9  # RMSProp's decay: TensorFlow 1's default, as in the original release (torch: 0.99)


class LeastSquaresGAN:
    """Generative adversarial network for points in [-1, 1], trained on points labelled positive or not.

    Source: Florensa et al. 2018, section 4.2, after Mao et al. 2017: the discriminator is trained towards +1
    on positive, and -1 on negative and generated points, the generator towards an output of +1. Layers are
    those of the paper, appendix A; initial weights, leaky units and optimisers those of its release. A batch
    has `batch_size` points and as many generated ones.
    """

    def __init__(self, size: int, learning_rate: float, batch_size: int, rng: np.random.Generator) -> None:
        seeded = torch_generator(rng)

        def layer(inputs: int, outputs: int) -> nn.Linear:
            return linear(inputs, outputs, torch.float32, seeded)

        wide, narrow = GENERATOR_UNITS, DISCRIMINATOR_UNITS
        self.generator = nn.Sequential(
            layer(size, wide), nn.ReLU(), layer(wide, wide), nn.ReLU(), layer(wide, size), nn.Tanh()
        )
        leaky = nn.LeakyReLU(LEAK)
        self.discriminator = nn.Sequential(
            layer(size, narrow), leaky, layer(narrow, narrow), leaky, layer(narrow, 1)
        )
        self._size, self._batch_size = size, batch_size
        self._generator_optimiser, self._discriminator_optimiser = (
            torch.optim.RMSprop(network.parameters(), learning_rate, alpha=SMOOTHING)
            for network in (self.generator, self.discriminator)
        )

    def generate(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Generate `count` points (count, d) in [-1, 1]."""
        with single_thread(), torch.no_grad():
            points: NDArray[np.float32] = self.generator(self._noise(count, rng)).numpy()
        return points.astype(np.float64)

    def train(
        self,
        points: NDArray[np.float64],
        positive: NDArray[np.bool_],
        iterations: int,
        rng: np.random.Generator,
    ) -> dict[str, float]:
        """Train both networks on points (n, d) with labels (n,), and return the mean losses."""
        inputs = torch.from_numpy(points.astype(np.float32))
        targets = torch.from_numpy(np.where(positive, 1.0, -1.0).astype(np.float32))[:, None]
        losses = np.empty((iterations, 2))
        with single_thread(), torch.enable_grad():
            for iteration in range(iterations):
                batch = torch.from_numpy(rng.integers(len(points), size=self._batch_size))
                generated = self.generator(self._noise(self._batch_size, rng))
                judged = self.discriminator(torch.cat([inputs[batch], generated.detach()]))
                aims = torch.cat([targets[batch], torch.full_like(targets[batch], -1.0)])
                discriminator_loss = nn.functional.mse_loss(judged, aims)
                descend(self._discriminator_optimiser, discriminator_loss)
                self.discriminator.requires_grad_(False)
                generator_loss = ((self.discriminator(generated) - 1) ** 2).mean()
                descend(self._generator_optimiser, generator_loss)
                self.discriminator.requires_grad_(True)
                losses[iteration] = discriminator_loss.item(), generator_loss.item()
        return dict(zip(("discriminator_loss", "generator_loss"), losses.mean(axis=0).tolist(), strict=True))

    def _noise(self, count: int, rng: np.random.Generator) -> torch.Tensor:
        return torch.from_numpy(rng.standard_normal((count, self._size), dtype=np.float32))


DTYPE = torch.float64  # float32 is too imprecise for the inverse, which multiplies the couplings' scales

BLOCKS = 3
GATED_LAYERS = 3
SMALLEST_SCALE = 0.01
UNIT_SCALE_INPUT = 0.9131652918237967  # solution x of SMALLEST_SCALE + slow_softplus(x) = 1
FACE_DISTANCE = 1e-4  # smallest distance of points from the box's faces, where a sigmoid's density diverges


class HighwayNetwork(nn.Module):
    """Network of one tanh layer, three gated tanh layers (Srivastava et al. 2015) and one linear layer.

    Untrained, its outputs are `start`.
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
        """Return outputs (n, outputs) for `inputs` (n, inputs)."""
        hidden = torch.tanh(self._first(inputs))
        for gate, layer in zip(self._gates, self._layers, strict=True):
            hidden = torch.lerp(hidden, torch.tanh(layer(hidden)), torch.sigmoid(gate(hidden)))
        outputs: torch.Tensor = self._last(hidden)
        return outputs


class AffineCoupling(nn.Module):
    """Affine coupling layer, which scales and shifts some coordinates depending on all other ones.

    Scale and shift are functions of the other coordinates and a condition.

    Untrained, it is the identity: with usual initial weights, each coupling would scale by a third, and all
    of them map to nearly a point. `moved` is a mask (d,) of the coordinates that change.
    """

    def __init__(self, moved: torch.Tensor, hidden: int, generator: torch.Generator) -> None:
        super().__init__()
        self._moved = moved
        outputs = int(moved.sum())
        inputs = len(moved) - outputs + 1
        self._scale_network = HighwayNetwork(inputs, hidden, outputs, UNIT_SCALE_INPUT, generator)
        self._shift_network = HighwayNetwork(inputs, hidden, outputs, 0.0, generator)

    def forward(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Transform `points` (n, d), and return them with the Jacobian's log-determinants (n,)."""
        scale, shift = self._scale_and_shift(points, condition)
        return self._replaced(points, points[:, self._moved] * scale + shift), scale.log().sum(dim=1)

    def inverse(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Invert `forward` at `points` (n, d); also return the log-determinants (n,) of `forward`."""
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
    """Normalising flow to the unit box, conditioned on a number in (0, 1).

    Sources: Dinh et al. 2017 (couplings), Racaniere et al. 2020, appendix (three blocks of three couplings:
    by halves, by the other halves, interlaced); scales, highway networks and precision from the original
    release. The sigmoid is clipped as in the paper, and so is the density. A single coordinate depends on the
    condition only.
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
        """Map `latents` (n, d) to points (n, d), and return them with their log-densities (n,)."""
        points, log_density = latents, _standard_log_density(latents)
        for coupling in self._couplings:
            points, log_determinant = coupling(points, condition)
            log_density = log_density - log_determinant
        clipped = points.clamp(-_LIMIT, _LIMIT)
        return torch.sigmoid(clipped), log_density - _log_slope(clipped)

    def inverse(self, points: torch.Tensor, condition: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Map `points` (n, d) to latents (n, d), and return them with the points' log-densities (n,)."""
        latents = torch.logit(points.clamp(FACE_DISTANCE, 1 - FACE_DISTANCE))
        log_density = -_log_slope(latents)
        for coupling in reversed(self._couplings):
            assert isinstance(coupling, AffineCoupling)
            latents, log_determinant = coupling.inverse(latents, condition)
            log_density = log_density - log_determinant
        return latents, log_density + _standard_log_density(latents)


_LIMIT = math.log((1 - FACE_DISTANCE) / FACE_DISTANCE)


def slow_softplus(inputs: torch.Tensor) -> torch.Tensor:
    """Return x (atan(x) / pi + 1/2) + 1/pi, a smooth positive approximation of max(0, x)."""
    return inputs * (torch.atan(inputs) / math.pi + 0.5) + 1 / math.pi


def _standard_log_density(points: torch.Tensor) -> torch.Tensor:
    return -0.5 * (points**2 + math.log(2 * math.pi)).sum(dim=1)


def _log_slope(points: torch.Tensor) -> torch.Tensor:
    """Return the log-determinant (n,) of the sigmoid's Jacobian at `points` (n, d)."""
    return (logsigmoid(points) + logsigmoid(-points)).sum(dim=1)


JUDGE_UNITS = 64


def new_networks(
    size: int, hidden_units: int, learning_rate: float, rng: np.random.Generator
) -> tuple[nn.Sequential, RealNVP, torch.optim.Optimizer, torch.optim.Optimizer]:
    """Return an untrained judge and setter for tasks of `size` dimensions, with their optimisers."""
    seeded = torch_generator(rng)
    layers: list[nn.Module] = []  # three hidden layers (paper, appendix A)
    for inputs in (size, JUDGE_UNITS, JUDGE_UNITS):
        layers += [linear(inputs, JUDGE_UNITS, DTYPE, seeded), nn.ReLU()]
    judge = nn.Sequential(*layers, linear(JUDGE_UNITS, 1, DTYPE, seeded))
    setter = RealNVP(size, hidden_units, seeded)
    judge_optimiser, setter_optimiser = (
        torch.optim.Adam(network.parameters(), learning_rate) for network in (judge, setter)
    )
    return judge, setter, judge_optimiser, setter_optimiser


def propose(
    setter: RealNVP, latents: NDArray[np.float64], feasibility: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the setter's points (n, d) for latents (n, d) and requested feasibilities (n,)."""
    with single_thread(), torch.no_grad():
        points, _ = setter(torch.from_numpy(latents), torch.from_numpy(feasibility))
    proposed: NDArray[np.float64] = points.numpy()
    return proposed


def update_judge(
    judge: nn.Sequential,
    optimiser: torch.optim.Optimizer,
    points: NDArray[np.float64],
    solved: NDArray[np.bool_],
) -> float:
    """Train the judge by one step on points (n, d) with outcomes (n,), and return its loss."""
    with single_thread(), torch.enable_grad():
        logits = judge(torch.from_numpy(points))[:, 0]
        successes = torch.from_numpy(solved).to(DTYPE)
        loss = nn.functional.binary_cross_entropy_with_logits(logits, successes)
        descend(optimiser, loss)
    return loss.item()


def update_setter(
    setter: RealNVP,
    judge: nn.Sequential,
    optimiser: torch.optim.Optimizer,
    proposed: tuple[NDArray[np.float64], NDArray[np.float64]],
    valid: tuple[NDArray[np.float64], NDArray[np.bool_]],
) -> dict[str, float]:
    """Train the setter by one step, and return its losses.

    `proposed` are latents (n, d) and requested feasibilities (n,), `valid` are solved tasks with noise (m, d)
    and their mask (n,) among the proposed.
    """
    latents, feasibility = proposed
    targets, solved = valid
    with single_thread(), torch.enable_grad():
        requested = torch.from_numpy(feasibility)
        points, log_density = setter(torch.from_numpy(latents), requested)
        judged = judge(points)[:, 0]
        losses = {
            "feasibility_loss": ((judged - torch.logit(requested)) ** 2).mean(),
            "coverage_loss": log_density.mean(),
        }
        if len(targets):
            _, likelihood = setter.inverse(torch.from_numpy(targets), requested[torch.from_numpy(solved)])
            losses["validity_loss"] = -likelihood.mean()
        descend(optimiser, torch.stack(list(losses.values())).sum())
    return {name: loss.item() for name, loss in losses.items()}
