"""PPO's update of one run: stable-baselines3's mathematics without its overhead."""

from __future__ import annotations

import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import explained_variance

from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.adam import FlatAdam
from tma_ray.students.mlp.modules import FlatParameters
from tma_ray.students.ppo.losses import Losses, Steps, losses
from tma_ray.students.rollout import Rollout


class PPOUpdate:
    """Trains the networks of `model`, whose policy and value share a `Trunk`.

    The model stays their owner, and the owner of the optimiser's state.

    Args:
        model: a set-up stable-baselines3 PPO.
        parameters: its network's, whose outputs are means and value, and its log deviation.
        hyperparameters: of the student.

    Attributes:
        flat: the parameters, as given.
        adam: their optimiser.
    """

    def __init__(
        self,
        model: stable_baselines3.PPO,
        parameters: FlatParameters,
        hyperparameters: PPOHyperparameters,
    ) -> None:
        self.flat = parameters
        self.adam = FlatAdam(model.policy.optimizer, parameters)
        self._model, self._hyper = model, hyperparameters
        self._trunks: torch.Tensor | None = None
        if hyperparameters.separate_trunks:
            (network,), means = parameters.networks, parameters.others[0].numel()
            self._trunks = torch.from_numpy(network.layout.trunks(means)).to(network.gradient)

    def restore(self) -> None:
        """Takes over the optimiser's state after the model was loaded."""
        self.adam.restore()

    def __call__(self, rollout: Rollout) -> None:
        """Passes several times over the finished `rollout`."""
        hyper, model = self._hyper, self._model
        parts = [self.train_on(batch) for _ in range(hyper.epochs) for batch in rollout.get(hyper.batch_size)]
        model._n_updates += hyper.epochs
        names = ("policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction")
        for name, values in zip(names, list(zip(*parts, strict=True))[:4], strict=True):
            model.logger.record(f"train/{name}", torch.stack(values).mean().item())
        model.logger.record("train/std", self.flat.others[0].detach().exp().mean().item())
        variance = explained_variance(rollout.values, rollout.returns)
        model.logger.record("train/explained_variance", variance)

    @torch.no_grad()  # the gradient is in closed form; recording for autograd costs a twentieth of a step
    def train_on(self, batch: RolloutBufferSamples) -> Losses:
        """Takes one optimiser step on the mini-batch `batch`; returns the losses before it."""
        (network,), (log_std,) = self.flat.networks, self.flat.others
        kept = network.activations(batch.observations)
        parts = losses(kept[-1], log_std, Steps(*batch), self._hyper)
        self.flat.backpropagate(kept, parts.outputs_gradient, [parts.log_std_gradient])
        if self._trunks is not None:
            network.gradient.mul_(self._trunks)
        norm = torch.linalg.vector_norm(self.flat.gradient)
        self.flat.gradient.mul_(torch.clamp(self._hyper.max_gradient_norm / (norm + 1e-6), max=1.0))
        self.adam.step()
        return parts
