"""Adam (arXiv:1412.6980) over the stacked flat parameters of k runs, each of which may sit a step out."""

from __future__ import annotations

import math

import torch

from tma_ray.optimisers import take_step

BETAS = 0.9, 0.999


class StackedAdam:
    """Steps as `torch.optim.Adam` does, with a step count for each run.

    Args:
        parameters: of all runs (k, ..., p), which `step` changes.
        rate: step size.
        epsilon: added to the root of the mean square.

    Attributes:
        mean: running mean of the gradient, like the parameters.
        square: running mean of its square, likewise.
    """

    def __init__(self, parameters: torch.Tensor, rate: float, epsilon: float = 1e-8) -> None:
        self._parameters, self._rate, self._epsilon = parameters, rate, epsilon
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        # computed once, on the host: powers would be rounded differently from device to device
        self._corrections = torch.tensor(_corrections(rate), dtype=parameters.dtype, device=parameters.device)

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:
        """Moves the parameters of the `active` runs (k,) against `gradient`; others' do not change by a bit.

        Args:
            gradient: like the parameters; of runs that are not active it may be anything.
            counts: steps of each run before this one (k,).
            active: True for the runs that take the step (k,).
        """
        aside = len(active), *[1] * (gradient.ndim - 1)
        mask, index = active.view(aside), (counts + 1).clamp(max=len(self._corrections) - 1)
        rate, root = (part.view(aside) for part in self._corrections[index].unbind(dim=1))
        mean = torch.lerp(self.mean, gradient, 1 - BETAS[0])
        square = torch.addcmul(self.square * BETAS[1], gradient, gradient, value=1 - BETAS[1])
        change = mean / (square.sqrt() / root + self._epsilon) * rate
        keep(self.mean, mean, mask)
        keep(self.square, square, mask)
        keep(self._parameters, self._parameters - change, mask)

    def row(self, slot: int, parameters: torch.Tensor) -> RowAdam:
        """Returns the optimiser of the run in `slot` alone, over the same moments.

        Args:
            slot: of the run.
            parameters: the same memory as the row of that slot (1, ..., p), a leaf of autograd.
        """
        one = slice(slot, slot + 1)
        optimiser = torch.optim.Adam([parameters], self._rate, BETAS, self._epsilon, fused=True)
        return RowAdam(optimiser, parameters, self.mean[one], self.square[one])


class RowAdam(StackedAdam):
    """Steps one run of a stack by torch's fused kernel, which takes a processor a sixth of the time.

    Args:
        optimiser: of the parameters.
        parameters: of the run (1, ..., p).
        mean: running mean of the gradient, like the parameters.
        square: running mean of its square, likewise.
    """

    def __init__(
        self,
        optimiser: torch.optim.Adam,
        parameters: torch.Tensor,
        mean: torch.Tensor,
        square: torch.Tensor,
    ) -> None:
        self._optimiser, self._parameters, self.mean, self.square = optimiser, parameters, mean, square
        self._count = torch.zeros((), dtype=torch.float32)
        optimiser.state[parameters] = {"step": self._count, "exp_avg": mean, "exp_avg_sq": square}

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:  # noqa: ARG002
        """Moves the parameters of the run, which is active; see `StackedAdam.step`."""
        self._count.copy_(counts[0])
        self._parameters.grad = gradient
        take_step(self._optimiser)


def keep(memory: torch.Tensor, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Writes `values` to `memory` where the `mask`, which broadcasts to them, is True."""
    memory.copy_(torch.where(mask, values, memory))


def _corrections(rate: float) -> list[tuple[float, float]]:
    """Returns rate / (1 - beta_1^t) and sqrt(1 - beta_2^t) for t = 0, 1, ... until they stay the same."""
    last = math.ceil(math.log(2.0**-54) / math.log(max(BETAS)))
    first, second = BETAS
    powers = ((first**step, second**step) for step in range(1, last + 1))
    return [(0.0, 1.0), *((rate / (1 - one), math.sqrt(1 - two)) for one, two in powers)]
