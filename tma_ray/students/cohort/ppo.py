"""Stacked PPO that updates many runs at once."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.cohort.device import compile_if, hidden_type, upload
from tma_ray.students.cohort.learner import StackedLearner, leaf, narrowed
from tma_ray.students.cohort.networks import PaddedLayout, StackedAdam, stacked_pass, write_masked
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.network import Network
from tma_ray.students.ppo import Losses, Steps, losses

EPSILON = 1e-5  # epsilon of Adam, as in stable-baselines3


def clip(gradient: torch.Tensor, norm: float) -> None:
    """Scale each run's gradient (k, p) down to a norm of at most `norm`, in place."""
    norms = torch.linalg.vector_norm(gradient, dim=1, keepdim=True)
    gradient.mul_(torch.clamp(norm / (norms + 1e-6), max=1.0))


METRICS = "policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction"


class PPONetworks(NamedTuple):
    """Learned state of a run in host memory, with unpadded parameters (p,) and the state of Adam."""

    parameters: NDArray[np.floating]
    mean: NDArray[np.floating]
    square: NDArray[np.floating]
    step: int


class StackedPPO(StackedLearner):
    """PPO of many runs; each update is one optimiser step on a mini-batch.

    Compiling takes minutes once. `sizes` are the lengths of an observation and an action.
    """

    _values: torch.Tensor  # only in views of one run (`_row`): its parameters, their gradient and network
    _gradient: torch.Tensor
    _network: Network

    def __init__(
        self,
        sizes: tuple[int, int],
        hyper: PPOHyperparameters,
        width: int,
        device: torch.device,
        dtype: torch.dtype = torch.float32,
        compiled: bool | str = False,
    ) -> None:
        super().__init__(width, device, dtype, hyper.matmul_precision, compiled)
        (observation, action), steps = sizes, hyper.steps_per_update
        self._hyper, self._split = hyper, [observation, action, 1, 1, 1, 1]
        self._layout = PaddedLayout.of(hyper.layout(observation, action), action)
        self._columns = torch.from_numpy(self._layout.columns()).to(device)
        like = torch.empty(0, dtype=dtype, device=device)
        count = self._layout.padded.parameters
        self._log_std = slice(count, count + action)
        self._hidden = hidden_type(hyper.matmul_precision, dtype)
        self._parameters = like.new_zeros(width, self._layout.length).requires_grad_()
        self._adam = StackedAdam(self._parameters, hyper.learning_rate, EPSILON)
        self._steps = torch.zeros(width, dtype=torch.int64, device=device)
        self._mask: torch.Tensor | None = None
        if hyper.separate_trunks:
            self._mask = like.new_ones(self._layout.length)
            plain = self._layout.plain
            self._mask[self._columns[: plain.parameters]] = torch.from_numpy(plain.trunks(action)).to(like)
        # compiled separately, because autograd runs in between
        self._parts = [compile_if(compiled, part) for part in (self._outputs, self._losses, self._step)]
        self._train: Callable[[Steps, torch.Tensor], torch.Tensor] = self._learn
        self._memory = torch.zeros(width, steps, sum(self._split), dtype=torch.float32, device=device)
        self._orders = torch.zeros(width, hyper.epochs * steps, dtype=torch.int32, device=device)
        self._positions = torch.zeros(width, dtype=torch.int64, device=device)
        self._sums = like.new_zeros(width, len(METRICS))

    def join(self, slot: int, networks: PPONetworks) -> None:
        """Assign the free `slot` to a new run that starts from `networks`."""
        self.leave(slot)
        self._write(slot, networks)

    def leave(self, slot: int) -> None:  # noqa: D102
        super().leave(slot)
        for memory in (self._memory, self._orders, self._positions, self._sums):
            memory[slot].zero_()

    def store(self, slot: int, columns: Sequence[NDArray[np.float32]], orders: NDArray[np.integer]) -> None:
        """Store a rollout's `columns` and the permutations `orders` (epochs, n); mark its updates as due."""
        assert not self.owed[slot]
        rows = np.concatenate([column.reshape(len(column), -1) for column in columns], axis=1)
        self._memory[slot].copy_(upload(rows, self._device))
        self._orders[slot].copy_(upload(orders.reshape(-1).astype(np.int32), self._device))
        self._positions[slot].fill_(0)
        self._sums[slot].zero_()
        self.owe(slot, orders.size // self._hyper.batch_size)

    def networks(self, slot: int) -> PPONetworks:
        """Return the learned state of the run in `slot`."""
        return PPONetworks._make(self._read(slot))

    def metrics(self, slot: int) -> dict[str, float]:
        """Return the metrics of the run in `slot`, averaged over the updates on its last rollout."""
        means = (self._sums[slot] / self._positions[slot].clamp(min=1)).tolist()
        return dict(zip(METRICS, means, strict=True))

    def _parameter_groups(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        memories = self._parameters, self._adam.mean, self._adam.square
        return [(memory, self._columns) for memory in memories]

    def _counters(self) -> list[torch.Tensor]:
        return [self._steps]

    def _row(self, slot: int) -> "StackedPPO":
        row = narrowed(self, slot, "_owed", "_memory", "_orders", "_positions", "_sums", "_steps")
        parameters, count = leaf(self._parameters, slot), self._layout.padded.parameters
        row._values, row._gradient = parameters.detach(), torch.zeros_like(parameters.detach())
        row._network = Network(row._values[0, :count], self._layout.padded, row._gradient[0, :count])
        row._adam, row._train = self._adam.row(slot, parameters), row._learn_alone
        return row

    def _advance_once(self) -> None:
        (width, count), size = self._orders.shape, self._hyper.batch_size
        taken = torch.arange(size, device=self._device) + self._positions[:, None] * size
        rows = self._orders.gather(1, taken % count).long()
        base = torch.arange(width, device=self._device)[:, None] * self._memory.shape[1]
        packed = self._memory.flatten(0, 1).index_select(0, (rows + base).flatten())
        columns = torch.split(packed.view(width, size, -1).to(self._dtype), self._split, dim=-1)
        active = self._owed > 0
        metrics = self._train(Steps(*columns[:2], *(column[..., 0] for column in columns[2:])), active)
        write_masked(self._sums, self._sums + metrics, active[:, None])
        self._positions.add_(active.long())
        self._owed.sub_(active.long())

    def _learn(self, batch: Steps, active: torch.Tensor) -> torch.Tensor:
        """Update the `active` runs (k,) once on mini-batches (k, n, ...), and return the metrics (k, 4)."""
        network, gradient_of, step = self._parts
        outputs = network(batch.observations)
        terms = gradient_of(outputs.detach(), batch)
        (gradient,) = torch.autograd.grad(outputs, self._parameters, terms.outputs_gradient)
        step(gradient, terms.log_std_gradient, active)
        return torch.stack(terms[:4], dim=1)

    def _outputs(self, observations: torch.Tensor) -> torch.Tensor:
        return stacked_pass(self._parameters, self._layout, observations, self._hidden)

    def _losses(self, outputs: torch.Tensor, batch: Steps) -> Losses:
        with torch.no_grad():
            return losses(outputs, self._parameters[:, self._log_std], batch, self._hyper)

    def _step(self, gradient: torch.Tensor, log_std_gradient: torch.Tensor, active: torch.Tensor) -> None:
        with torch.no_grad():
            gradient = gradient.clone()
            gradient[:, self._log_std] = log_std_gradient
            if self._mask is not None:
                gradient.mul_(self._mask)
            clip(gradient, self._hyper.max_gradient_norm)
            self._adam.step(gradient, self._steps, active)
            self._steps.add_(active.long())

    @torch.no_grad()
    def _learn_alone(self, batch: Steps, active: torch.Tensor) -> torch.Tensor:
        """Update a single run once, with the same forward and backward pass as a student outside a cohort."""
        kept = self._network.activations(self._layout.inputs(batch.observations[0]))
        terms = losses(kept[-1][None], self._values[:, self._log_std], batch, self._hyper)
        self._network.backpropagate(kept, terms.outputs_gradient[0])
        self._gradient[:, self._log_std] = terms.log_std_gradient
        if self._mask is not None:
            self._gradient.mul_(self._mask)
        clip(self._gradient, self._hyper.max_gradient_norm)
        self._adam.step(self._gradient, self._steps, active)
        self._steps.add_(1)
        return torch.stack(terms[:4], dim=1)
