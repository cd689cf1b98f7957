"""Losses of soft actor-critic, of one run or of k stacked ones; autograd differentiates them.

Shapes are those of one run; stacked runs have (k, ...) of everything, and losses (k,). Networks are given as
functions: ``actor`` maps observations (n, o) to means and log deviations, before these are brought into their
range (n, 2a), ``critics`` map observations and actions (n, o + a) to the value of each critic (n, c).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import torch

from tma_ray.students.hyperparameters import LogStd
from tma_ray.students.sac.acting import LOG_STD_RANGE

SQUASH_EPSILON = 1e-6
"""Keeps the logarithm of the squashing's derivative finite, as in stable-baselines3."""

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)

Pass: TypeAlias = Callable[[torch.Tensor], torch.Tensor]
"""A network, as a function of its inputs."""


class Transitions(NamedTuple):
    """A batch of n transitions; stable-baselines3's samples have these attributes, too.

    Attributes:
        observations: (n, o).
        actions: in [-1, 1] (n, a).
        next_observations: (n, o).
        dones: 1 where nothing follows (n, 1).
        rewards: (n, 1).
    """

    observations: torch.Tensor
    actions: torch.Tensor
    next_observations: torch.Tensor
    dones: torch.Tensor
    rewards: torch.Tensor


class Draw(NamedTuple):
    """Actions drawn from the policy.

    Attributes:
        actions: squashed to [-1, 1] (n, a).
        log_probabilities: of the actions (n, 1).
    """

    actions: torch.Tensor
    log_probabilities: torch.Tensor


def in_range(outputs: torch.Tensor, log_std: LogStd) -> torch.Tensor:
    """Returns the log deviations, within `LOG_STD_RANGE`, of an actor's `outputs` for them."""
    low, high = LOG_STD_RANGE
    if log_std is LogStd.CLAMP:
        return outputs.clamp(low, high)
    return low + 0.5 * (high - low) * (outputs.tanh() + 1)


def squashed_draw(outputs: torch.Tensor, noise: torch.Tensor, log_std: LogStd) -> Draw:
    """Returns the tangent hyperbolic of normal variables, and its log density.

    Args:
        outputs: of the actor (n, 2a).
        noise: standard normal (n, a).
        log_std: map to the log deviations.
    """
    mean, log_deviation = outputs.chunk(2, dim=-1)
    log_deviation = in_range(log_deviation, log_std)
    actions = (mean + log_deviation.exp() * noise).tanh()
    log_density = -0.5 * noise.square() - log_deviation - _HALF_LOG_2PI
    log_squashing = (1 - actions.square() + SQUASH_EPSILON).log()
    return Draw(actions, (log_density - log_squashing).sum(dim=-1, keepdim=True))


def joined(critics: Sequence[Pass]) -> Pass:
    """Returns the function that gives the values of all `critics` (n, c)."""
    return lambda inputs: torch.cat([critic(inputs) for critic in critics], dim=-1)


def soft_values(critics: Pass, observations: torch.Tensor, draw: Draw, alpha: float) -> torch.Tensor:
    """Returns min Q - alpha log pi (n, 1) of the actions in `draw`."""
    values = critics(torch.cat((observations, draw.actions), dim=-1))
    return values.min(dim=-1, keepdim=True).values - alpha * draw.log_probabilities


def critic_loss(critics: Pass, batch: Transitions, targets: torch.Tensor) -> torch.Tensor:
    """Returns half the mean squared error of each critic, summed over the critics.

    Args:
        critics: to be trained.
        batch: transitions.
        targets: r + gamma (1 - done) V(s'), which no gradient passes (n, 1).
    """
    values = critics(torch.cat((batch.observations, batch.actions), dim=-1))
    return 0.5 * (values - targets).square().mean(dim=-2).sum(dim=-1)


def actor_loss(critics: Pass, observations: torch.Tensor, draw: Draw, alpha: float) -> torch.Tensor:
    """Returns the mean of alpha log pi - min Q over the actions in `draw`, drawn from the actor."""
    return -soft_values(critics, observations, draw, alpha).mean(dim=(-2, -1))
