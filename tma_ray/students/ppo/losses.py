"""Loss of proximal policy optimisation and its gradient, of one run or of k stacked ones.

The loss is policy + value coefficient * value - entropy coefficient * entropy of the actions. An update needs
its gradient only, which is in closed form: that saves 3 to 8 % of a training step over autograd.
Shapes are those of one run; stacked runs have (k, ...) of everything, and losses (k,).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch

from tma_ray.students.hyperparameters import PPOHyperparameters

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class Steps(NamedTuple):
    """A mini-batch of n steps; stable-baselines3's samples have these attributes in this order.

    Attributes:
        observations: normalised (n, o).
        actions: as sampled (n, a).
        old_values: values of the observations when they were made (n,).
        old_log_prob: log probabilities of the actions when they were taken (n,).
        advantages: not normalised (n,).
        returns: advantages plus old values (n,).
    """

    observations: torch.Tensor
    actions: torch.Tensor
    old_values: torch.Tensor
    old_log_prob: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor


class Losses(NamedTuple):
    """Parts of the loss, and figures for logging, one number per run each; and the gradient.

    Attributes:
        policy: of the clipped surrogate objective.
        value: mean squared error.
        divergence: approximate Kullback-Leibler divergence from the old policy.
        clipped: share of ratios beyond the clip range.
        outputs_gradient: of the loss by the outputs (n, a + 1).
        log_std_gradient: of the loss by the log deviation (a,).
    """

    policy: torch.Tensor
    value: torch.Tensor
    divergence: torch.Tensor
    clipped: torch.Tensor
    outputs_gradient: torch.Tensor
    log_std_gradient: torch.Tensor


def losses(outputs: torch.Tensor, log_std: torch.Tensor, steps: Steps, hyper: PPOHyperparameters) -> Losses:
    """Returns the parts of a mini-batch's loss, and its gradient (arXiv:1707.06347, equations 7 and 9).

    Args:
        outputs: of the network: means of the actions, and the value (n, a + 1).
        log_std: log deviation of the actions (a,).
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
    gradient, log_std_gradient = _policy_gradients(surrogates, error, deviation)
    log_std_gradient -= hyper.entropy_coefficient
    value_gradient = (2 * hyper.value_coefficient / error.shape[-2]) * value_error * free
    gradient = torch.cat((gradient, value_gradient[..., None]), dim=-1)
    return Losses(policy, value, divergence, clipped, gradient, log_std_gradient)


def log_density(error: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Returns the log density (n,) of actions that are `error` (n, a) deviations off their means."""
    return -(0.5 * error.square() + (log_std + _HALF_LOG_2PI)).sum(dim=-1)


def _policy_gradients(
    surrogates: tuple[torch.Tensor, torch.Tensor], error: torch.Tensor, deviation: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns the policy loss's gradients by the means (n, a) and by the log deviation (a,).

    Args:
        surrogates: advantages times ratios (n,), and times clipped ratios (n,); the smaller one counts, and
            where that is the clipped one, the gradient is zero.
        error: of the actions from the means, in deviations (n, a).
        deviation: of the actions (1, a).
    """
    free, clipped = surrogates
    share = (free * (free <= clipped)).div_(-free.shape[-1])[..., None]
    return share * error / deviation, (share * (error.square() - 1)).sum(dim=-2)


def _value_error(
    values: torch.Tensor, steps: Steps, clip: float | None
) -> tuple[torch.Tensor, torch.Tensor | float]:
    """Returns how far off the clipped `values` (n,) are, and 1 where the clipping lets a gradient through."""
    if clip is None:
        return values - steps.returns, 1.0
    change = values - steps.old_values
    return steps.old_values + change.clamp(-clip, clip) - steps.returns, change.abs() <= clip
