"""Loss of proximal policy optimisation, of one run or of k stacked ones; autograd differentiates it.

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
    """Parts of the loss, and figures for logging; each is one number per run.

    Attributes:
        total: to be differentiated.
        policy: of the clipped surrogate objective.
        value: mean squared error.
        divergence: approximate Kullback-Leibler divergence from the old policy.
        clipped: share of ratios beyond the clip range.
    """

    total: torch.Tensor
    policy: torch.Tensor
    value: torch.Tensor
    divergence: torch.Tensor
    clipped: torch.Tensor


def losses(outputs: torch.Tensor, log_std: torch.Tensor, steps: Steps, hyper: PPOHyperparameters) -> Losses:
    """Returns the loss of a mini-batch (arXiv:1707.06347, equations 7 and 9).

    Args:
        outputs: of the network: means of the actions, and the value (n, a + 1).
        log_std: log deviation of the actions (a,).
        steps: the mini-batch.
        hyper: of the student.
    """
    advantages = steps.advantages
    centred = advantages - advantages.mean(dim=-1, keepdim=True)
    advantages = centred / (advantages.std(dim=-1, keepdim=True) + 1e-8)
    log_std = log_std[..., None, :]
    log_ratio = log_probability(steps.actions - outputs[..., :-1], log_std) - steps.old_log_prob
    ratio, clip = log_ratio.exp(), hyper.clip_range
    bounded = ratio.clamp(1 - clip, 1 + clip)
    policy = -torch.minimum(advantages * ratio, advantages * bounded).mean(dim=-1)
    value = _value_loss(outputs[..., -1], steps, hyper.value_clip_range)
    entropy = (0.5 + _HALF_LOG_2PI + log_std).sum(dim=(-2, -1))
    total = policy + hyper.value_coefficient * value - hyper.entropy_coefficient * entropy
    with torch.no_grad():
        divergence = (ratio - 1 - log_ratio).mean(dim=-1)
        clipped = ((ratio - 1).abs() > clip).to(ratio.dtype).mean(dim=-1)
    return Losses(total, policy.detach(), value.detach(), divergence, clipped)


def log_probability(error: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Returns the log density (n,) of actions that are `error` (n, a) off their means."""
    return -(0.5 * (error / log_std.exp()).square() + (log_std + _HALF_LOG_2PI)).sum(dim=-1)


def _value_loss(values: torch.Tensor, steps: Steps, clip: float | None) -> torch.Tensor:
    if clip is not None:
        values = steps.old_values + (values - steps.old_values).clamp(-clip, clip)
    return (values - steps.returns).square().mean(dim=-1)
