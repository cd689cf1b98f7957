"""PPO on top of stable-baselines3, with the paper's hyper-parameters and normalisation."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import stable_baselines3
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import explained_variance
from torch import nn

from tma_ray.students.base import Actions, Observations, Policy
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.layers import (
    Clamp,
    GreedyNetwork,
    Standardise,
    as_sequential,
    check_rows,
    stored_network,
    stored_parameters,
    tensor_specs,
)
from tma_ray.students.mlp.layout import Activation
from tma_ray.students.mlp.network import MODULES, FlatAdam, FlatParameters, as_batch, as_modules, blocks_of
from tma_ray.students.normaliser import MEAN_TENSOR, VARIANCE_TENSOR, Normaliser, scaled
from tma_ray.students.policy_files import StoredPolicy, read_policy, write_policy
from tma_ray.students.rollout_workers.ppo import PPOActing, Rollout
from tma_ray.students.sb3.base import StableBaselinesStudent


class Trunk(BaseFeaturesExtractor):
    """Hidden layers shared by policy and value.

    stable-baselines3 shares features extractors only, so they are one.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        hidden_units: tuple[int, ...],
        activation: Activation = Activation.RELU,
    ) -> None:
        super().__init__(observation_space, features_dim=hidden_units[-1])
        layers = create_mlp(observation_space.shape[0], -1, list(hidden_units), MODULES[activation])
        self.layers = nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the last hidden layer (n, h) of `observations` (n, o)."""
        features: torch.Tensor = self.layers(observations)
        return features


@torch.no_grad()
def init_separate_trunks(trunk: Trunk, means: nn.Linear, value: nn.Linear) -> None:
    """Initialise `trunk` as two separate networks, with orthogonal weights as in stable-baselines3.

    The first half of each hidden layer leads to the `means`, the second to the `value`; weights between the
    halves are 0.
    """
    hidden = [layer.weight for layer in trunk.layers if isinstance(layer, nn.Linear)]
    for index, weight in enumerate(hidden):
        outputs, inputs = weight.shape[0] // 2, weight.shape[1] // 2
        halves = [weight[:outputs], weight[outputs:]]
        if index:
            weight.zero_()
            halves = [halves[0][:, :inputs], halves[1][:, inputs:]]
        for half in halves:
            nn.init.orthogonal_(half, math.sqrt(2))
    for weight, gain, columns in (
        (means.weight, 0.01, slice(outputs)),
        (value.weight, 1.0, slice(outputs, None)),
    ):
        weight.zero_()
        nn.init.orthogonal_(weight[:, columns], gain)


_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class Steps(NamedTuple):
    """A mini-batch of n steps, with the same fields as stable-baselines3's samples.

    Attributes:
        observations: normalised observations (n, o).
        actions: sampled actions (n, a).
        old_values: values of the observations before the update (n,).
        old_log_prob: log probabilities of the actions before the update (n,).
        advantages: advantages, not normalised (n,).
        returns: advantages plus old values (n,).
    """

    observations: torch.Tensor
    actions: torch.Tensor
    old_values: torch.Tensor
    old_log_prob: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor


class Losses(NamedTuple):
    """Losses, metrics and gradients of a mini-batch, with one value of each loss and metric per run.

    Attributes:
        policy: clipped surrogate objective.
        value: mean squared error.
        divergence: approximate Kullback-Leibler divergence from the old policy.
        clipped: share of ratios beyond the clip range.
        outputs_gradient: gradient of the loss with respect to the outputs (n, a + 1).
        log_std_gradient: gradient of the loss with respect to the log standard deviation (a,).
    """

    policy: torch.Tensor
    value: torch.Tensor
    divergence: torch.Tensor
    clipped: torch.Tensor
    outputs_gradient: torch.Tensor
    log_std_gradient: torch.Tensor


def losses(outputs: torch.Tensor, log_std: torch.Tensor, steps: Steps, hyper: PPOHyperparameters) -> Losses:
    """Return the losses, metrics and gradients of a mini-batch (arXiv:1707.06347, equations 7 and 9).

    Args:
        outputs: action means and value (n, a + 1).
        log_std: log standard deviation of the actions (a,).
        steps: the mini-batch.
        hyper: hyper-parameters of the student.
    """
    advantages, clip = steps.advantages, hyper.clip_range
    centred = advantages - advantages.mean(dim=-1, keepdim=True)
    advantages = centred / (advantages.std(dim=-1, keepdim=True) + 1e-8)
    log_std = log_std[..., None, :]
    deviation = log_std.exp()
    error = (steps.actions - outputs[..., :-1]) / deviation
    log_ratio = log_density(error, log_std) - steps.old_log_prob
    ratio = log_ratio.exp()
    surrogates = advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)
    value_error, free = _value_error(outputs[..., -1], steps, hyper.value_clip_range)
    policy, value = -torch.minimum(*surrogates).mean(dim=-1), value_error.square().mean(dim=-1)
    divergence = (ratio - 1 - log_ratio).mean(dim=-1)
    clipped = ((ratio - 1).abs() > clip).to(ratio.dtype).mean(dim=-1)
    # the gradient is zero where the clipped surrogate is smaller
    share = (surrogates[0] * (surrogates[0] <= surrogates[1])).div_(-ratio.shape[-1])[..., None]
    gradient = share * error / deviation
    log_std_gradient = (share * (error.square() - 1)).sum(dim=-2) - hyper.entropy_coefficient
    value_gradient = (2 * hyper.value_coefficient / error.shape[-2]) * value_error * free
    gradient = torch.cat((gradient, value_gradient[..., None]), dim=-1)
    return Losses(policy, value, divergence, clipped, gradient, log_std_gradient)


def log_density(error: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Return the log density (n,) of actions with standardised `error` (n, a)."""
    return -(0.5 * error.square() + (log_std + _HALF_LOG_2PI)).sum(dim=-1)


def _value_error(
    values: torch.Tensor, steps: Steps, clip: float | None
) -> tuple[torch.Tensor, torch.Tensor | float]:
    """Return the errors (n,) of `values` (n,) after clipping, and a mask (n,) of the unclipped ones."""
    if clip is None:
        return values - steps.returns, 1.0
    change = values - steps.old_values
    return steps.old_values + change.clamp(-clip, clip) - steps.returns, change.abs() <= clip


class PPOUpdate:
    """PPO's update, applied to a stable-baselines3 model that owns the networks and optimiser state."""

    def __init__(
        self, model: stable_baselines3.PPO, parameters: FlatParameters, hyperparameters: PPOHyperparameters
    ) -> None:
        self.flat = parameters
        self.adam = FlatAdam(model.policy.optimizer, parameters)
        self._model, self._hyper = model, hyperparameters
        self._trunks: torch.Tensor | None = None
        if hyperparameters.separate_trunks:
            (network,), means = parameters.networks, parameters.others[0].numel()
            self._trunks = torch.from_numpy(network.layout.trunks(means)).to(network.gradient)

    def __call__(self, rollout: Rollout) -> None:
        """Train on the finished `rollout` for all epochs, and log the metrics."""
        hyper, model = self._hyper, self._model
        batches = (batch for _ in range(hyper.epochs) for batch in rollout.get(hyper.batch_size))
        terms = [self.train_on(batch) for batch in batches]
        model._n_updates += hyper.epochs
        names = ("policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction")
        for name, values in zip(names, list(zip(*terms, strict=True))[:4], strict=True):
            model.logger.record(f"train/{name}", torch.stack(values).mean().item())
        model.logger.record("train/std", self.flat.others[0].detach().exp().mean().item())
        variance = explained_variance(rollout.values, rollout.returns)
        model.logger.record("train/explained_variance", variance)

    @torch.no_grad()  # gradients are in closed form, which saves 5 % of a step's time
    def train_on(self, batch: RolloutBufferSamples) -> Losses:
        """Take one optimiser step on the mini-batch `batch`, and return the losses before the step."""
        (network,), (log_std,) = self.flat.networks, self.flat.others
        kept = network.activations(batch.observations)
        terms = losses(kept[-1], log_std, Steps(*batch), self._hyper)
        self.flat.backpropagate(kept, terms.outputs_gradient, [terms.log_std_gradient])
        if self._trunks is not None:
            network.gradient.mul_(self._trunks)
        norm = torch.linalg.vector_norm(self.flat.gradient)
        self.flat.gradient.mul_(torch.clamp(self._hyper.max_gradient_norm / (norm + 1e-6), max=1.0))
        self.adam.step()
        return terms


NORMALISER_FILE = "normaliser.json"
AVERAGE_FILE = "average.npy"

POLICY = "ppo"  # name of the student in saved policies, including those of `StockPPO`


class PPO(PPOActing, StableBaselinesStudent[PPOHyperparameters, stable_baselines3.PPO]):
    """Proximal policy optimisation (PPO), by default with 5 epochs on every 2,000 steps.

    Observations and rewards are normalised with running statistics, which evaluation does not change and a
    reset keeps. The greedy action is the mean, clipped to the action space (the original release evaluates
    with sampled actions). Truncated episodes bootstrap from the value of the last observation (in the
    release, of the next episode's first one).
    """

    device: torch.device
    _acting: GreedyNetwork
    _greedy: GreedyNetwork

    def _make_model(self) -> stable_baselines3.PPO:
        hyper = self.hyperparameters
        return stable_baselines3.PPO(
            "MlpPolicy",
            env=None,  # type: ignore[arg-type]  # stepped by the run, not by the model
            learning_rate=hyper.learning_rate,
            n_steps=hyper.steps_per_update,
            batch_size=hyper.batch_size,
            n_epochs=hyper.epochs,
            gamma=hyper.gamma,
            gae_lambda=hyper.gae_lambda,
            clip_range=hyper.clip_range,
            clip_range_vf=hyper.value_clip_range,
            ent_coef=hyper.entropy_coefficient,
            vf_coef=hyper.value_coefficient,
            max_grad_norm=hyper.max_gradient_norm,
            policy_kwargs={
                "net_arch": [],
                "activation_fn": MODULES[hyper.activation],
                "features_extractor_class": Trunk,
                "features_extractor_kwargs": {
                    "hidden_units": self._layout.sizes[1:-1],
                    "activation": hyper.activation,
                },
            },
            device=self.device,
            _init_setup_model=False,
        )

    def _start(self) -> None:
        super()._start()
        self._layout = self.hyperparameters.layout(self.observation_space.shape[0], self._low.size)

    def _connect(self) -> None:
        hyper = self.hyperparameters
        policy: Any = self.model.policy
        if hyper.separate_trunks:
            with self._torch_stream.active():
                init_separate_trunks(policy.features_extractor, policy.action_net, policy.value_net)
        self.model.rollout_buffer = self.rollout  # type: ignore[assignment]
        self.rollout.clear()
        blocks = blocks_of(policy.features_extractor, policy.action_net, policy.value_net)
        self._flat = FlatParameters([blocks], [policy.log_std], hyper.activation)
        (self._network,) = self._flat.networks
        self._acting = GreedyNetwork(self._network.parameters, self._layout, self._low.size)
        self._greedy = self._acting
        if hyper.averaged_steps:
            self._average = self._network.parameters.detach().clone()
            self._greedy = GreedyNetwork(self._average, self._layout, self._low.size)

    def _refresh(self) -> None:
        self._acting.refresh()
        self._greedy.refresh()
        log_std: NDArray[np.float32] = self._flat.others[0].numpy(force=True).copy()
        self._policy = log_std, np.stack([self._low, self._high])

    def _prepare_update(self) -> None:  # code that changes parameters by `update` must call `changed`
        self.update = PPOUpdate(self.model, self._flat, self.hyperparameters)

    def _train(self) -> None:
        self.update(self.rollout)

    @property
    def average(self) -> NDArray[np.float32] | None:  # noqa: D102
        return self._average.numpy(force=True).copy() if self.hyperparameters.averaged_steps else None

    def put_average(self, average: NDArray[np.float32]) -> None:  # noqa: D102
        self._average.copy_(torch.from_numpy(average))
        self._greedy.refresh()

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o), rescaled from normalised to raw rewards."""
        with torch.no_grad():
            outputs = self._network.frozen(as_batch(self.normaliser.normalise(observations), self.device))
        values: NDArray[np.float64] = outputs[:, -1].numpy(force=True).astype(np.float64)
        return values * self.normaliser.reward_scale

    def save_policy(self, folder: Path) -> None:
        """Write the layers that compute the mean action (float32), and the observation statistics (float64).

        To act elsewhere, apply ``clip((observation - mean) / sqrt(variance + 1e-8), -observation_clip,
        observation_clip)``, then the layers with activations between, and clip to the action space.
        """
        hyper = self.hyperparameters
        values: dict[str, Any] = {
            "hidden_units": list(self._layout.sizes[1:-1]),
            "observation_clip": hyper.observation_clip,
        }
        if hyper.activation is not Activation.RELU:  # files without this entry default to ReLU
            values["activation"] = hyper.activation.value
        tensors = {**self._greedy.tensors(), **self.normaliser.tensors()}
        write_policy(folder, POLICY, self.observation_space, self.action_space, tensors, values)

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:  # noqa: D102
        stored = _stored(folder)
        clip = stored.hyperparameters["observation_clip"]
        network = stored_network(stored, device)
        mean, variance = (stored.tensors[name] for name in (MEAN_TENSOR, VARIANCE_TENSOR))
        low, high = stored.action_space.low, stored.action_space.high

        def act(observations: Observations) -> Actions:
            check_rows(observations, len(mean))
            rows = np.ascontiguousarray(observations)
            means = network(scaled(rows, mean, variance, clip), squash=False)
            actions: Actions = np.minimum(np.maximum(means, low), high)
            return actions

        return act

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: D102
        stored = _stored(folder)
        statistics = stored.tensors[MEAN_TENSOR], stored.tensors[VARIANCE_TENSOR]
        first = Standardise(*statistics, stored.hyperparameters["observation_clip"])
        last = Clamp(stored.action_space.low, stored.action_space.high)
        return as_sequential([first, *as_modules(*stored_parameters(stored)), last])

    def _save_experience(self, folder: Path, _incremental: bool) -> tuple[dict[str, Any], tuple[str, ...]]:
        self.normaliser.save(folder / NORMALISER_FILE)
        np.savez(folder / "rollout.npz", **self.rollout.state())
        if self.hyperparameters.averaged_steps:
            np.save(folder / AVERAGE_FILE, self._average.numpy(force=True))
        return {}, ()

    def _load_experience(self, folder: Path, _counters: dict[str, Any]) -> None:
        average = np.load(folder / AVERAGE_FILE) if self.hyperparameters.averaged_steps else None
        normaliser = Normaliser.load(folder / NORMALISER_FILE)
        with np.load(folder / "rollout.npz") as rollout:
            self.restore_experience({"normaliser": normaliser, "rollout": rollout, "average": average})

    def _finish_rollout(self, next_observation: Observations) -> None:
        last_value = self._value(next_observation)
        self.rollout.finish(last_value, self.gamma, self.hyperparameters.gae_lambda)
        with self._updating():
            self._train()
            if self.hyperparameters.averaged_steps:
                self._average.lerp_(self._network.parameters.detach(), self.hyperparameters.averaging)
        self.rollout.clear()


class StockPPO(PPO):
    """PPO that is updated by stable-baselines3's own `train`."""

    def _connect(self) -> None:
        super()._connect()
        if self.hyperparameters.separate_trunks:  # autograd would also train the weights between the trunks
            mask = torch.ones_like(self._flat.values)
            trunks = torch.from_numpy(self._layout.trunks(self._low.size))
            mask[: len(trunks)] = trunks.to(mask)
            for parameter, view in zip(self._flat.parameters, self._flat.views(mask), strict=True):
                parameter.register_hook(view.mul)  # type: ignore[no-untyped-call]

    def _prepare_update(self) -> None:
        """Do nothing, since the model's own optimiser is used."""

    def _train(self) -> None:
        self.model.train()


def _stored(folder: Path) -> StoredPolicy:
    """Return the checked policy in `folder`."""
    stored = read_policy(folder, POLICY)
    stored.check({**tensor_specs(stored), **Normaliser.tensor_specs(*stored.observation_space.shape)})
    clip = stored.hyperparameters.get("observation_clip")
    if not isinstance(clip, float) or not clip > 0:
        stored.refuse(f"observation_clip = {clip!r:.80}: expected a number over 0")
    return stored
