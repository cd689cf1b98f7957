"""PPO's step on a mini-batch of k runs at once: plain batched torch."""

from __future__ import annotations

import torch

from tma_ray.students.cohort.adam import StackedAdam
from tma_ray.students.cohort.execution import compile_if, hidden_type
from tma_ray.students.cohort.networks import stacked_pass
from tma_ray.students.cohort.padding import PaddedLayout
from tma_ray.students.cohort.rows import leaf
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.network import Network
from tma_ray.students.ppo.losses import Losses, Steps, losses

EPSILON = 1e-5
"""Of Adam, as in stable-baselines3's policies."""


class StackedPPOUpdate:
    """Networks and optimiser of k runs, in a padded layout, and the step that trains them.

    Args:
        layout: of the network, whose outputs are means and value; the log deviation follows it.
        hyper: hyper-parameters of the student.
        width: number of runs k.
        like: an empty tensor with the device and the type of the parameters.
        compiled: see `compile_if`.

    Attributes:
        parameters: of networks and log deviations (k, p), a leaf of autograd.
        adam: the optimiser.
        steps: of the optimiser (k,).
    """

    def __init__(
        self,
        layout: PaddedLayout,
        hyper: PPOHyperparameters,
        width: int,
        like: torch.Tensor,
        compiled: bool | str = False,
    ) -> None:
        self._layout, self._hyper = layout, hyper
        self._hidden = hidden_type(hyper.matmul_precision, like.dtype)
        self._log_std = slice(layout.padded.parameters, layout.padded.parameters + layout.others)
        self.parameters = like.new_zeros(width, layout.length).requires_grad_()
        self.adam = StackedAdam(self.parameters, hyper.learning_rate, EPSILON)
        self.steps = torch.zeros(width, dtype=torch.int64, device=like.device)
        self._kept: torch.Tensor | None = None
        if hyper.separate_trunks:
            self._kept = like.new_ones(layout.length)
            places = torch.from_numpy(layout.places()[: layout.plain.parameters])
            self._kept[places] = torch.from_numpy(layout.plain.trunks(layout.others)).to(like)
        # compiled part by part: autograd runs between them, through what the compiler derived
        self._parts = [compile_if(compiled, part) for part in (self._outputs, self._losses, self._step)]

    def row(self, slot: int) -> RowPPOUpdate:
        """Returns the step of the run in `slot` alone, over the same memory."""
        return RowPPOUpdate(self, slot)

    def __call__(self, batch: Steps, active: torch.Tensor) -> torch.Tensor:
        """Takes one step of the `active` runs (k,) on their mini-batches (k, n, ...).

        Returns:
            Policy's and value's loss, divergence and clipped share before it (k, 4).
        """
        network, gradient_of, step = self._parts
        outputs = network(batch.observations)
        parts = gradient_of(outputs.detach(), batch)
        (gradient,) = torch.autograd.grad(outputs, self.parameters, parts.outputs_gradient)
        step(gradient, parts.log_std_gradient, active)
        return torch.stack(parts[:4], dim=1)

    def _outputs(self, observations: torch.Tensor) -> torch.Tensor:
        return stacked_pass(self.parameters, self._layout, observations, self._hidden)

    def _losses(self, outputs: torch.Tensor, batch: Steps) -> Losses:
        with torch.no_grad():
            return losses(outputs, self.parameters[:, self._log_std], batch, self._hyper)

    def _step(self, gradient: torch.Tensor, log_std_gradient: torch.Tensor, active: torch.Tensor) -> None:
        with torch.no_grad():
            gradient = gradient.clone()
            gradient[:, self._log_std] = log_std_gradient
            if self._kept is not None:
                gradient.mul_(self._kept)
            clip(gradient, self._hyper.max_gradient_norm)
            self.adam.step(gradient, self.steps, active)
            self.steps.add_(active.long())


class RowPPOUpdate:
    """The step of one run of a stack, over its row, by the passes of a run that learns alone.

    Args:
        stacked: all runs' step, whose hidden layers are in the type of the parameters.
        slot: of the run.
    """

    def __init__(self, stacked: StackedPPOUpdate, slot: int) -> None:
        one, count = slice(slot, slot + 1), stacked._layout.padded.parameters
        self._layout, self._hyper, self._log_std = stacked._layout, stacked._hyper, stacked._log_std
        self._kept = stacked._kept
        self._values, self._steps = stacked.parameters.detach()[one], stacked.steps[one]
        self._gradient = torch.zeros_like(self._values)
        memory = self._values[0, :count], self._gradient[0, :count]
        self._network = Network(memory[0], stacked._layout.padded, memory[1])
        self._adam = stacked.adam.row(slot, leaf(stacked.parameters, slot))

    @torch.no_grad()
    def __call__(self, batch: Steps, active: torch.Tensor) -> torch.Tensor:
        """Takes one step; arguments and result as of `StackedPPOUpdate`, of the one run, which is active."""
        kept = self._network.activations(self._layout.inputs(batch.observations[0]))
        parts = losses(kept[-1][None], self._values[:, self._log_std], batch, self._hyper)
        self._network.backpropagate(kept, parts.outputs_gradient[0])
        self._gradient[:, self._log_std] = parts.log_std_gradient
        if self._kept is not None:
            self._gradient.mul_(self._kept)
        clip(self._gradient, self._hyper.max_gradient_norm)
        self._adam.step(self._gradient, self._steps, active)
        self._steps.add_(1)
        return torch.stack(parts[:4], dim=1)


def clip(gradient: torch.Tensor, norm: float) -> None:
    """Scales each run's gradient (k, p) down to a norm."""
    own = torch.linalg.vector_norm(gradient, dim=1, keepdim=True)
    gradient.mul_(torch.clamp(norm / (own + 1e-6), max=1.0))
