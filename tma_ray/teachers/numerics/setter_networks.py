"""The networks of Setter-Solver and their updates."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tma_ray.teachers.numerics.networks import descend, inference, linear, torch_generator, training
from tma_ray.teachers.numerics.real_nvp import DTYPE, RealNVP

JUDGE_UNITS = 64


def new_networks(size: int, hidden_units: int, rng: np.random.Generator) -> tuple[nn.Sequential, RealNVP]:
    """Returns a judge and a setter that have learned nothing.

    Args:
        size: dimensions of a task.
        hidden_units: of each layer of the setter's networks.
        rng: draws the initial weights.
    """
    seeded = torch_generator(rng)
    return _judge(size, seeded), RealNVP(size, hidden_units, seeded)


def adam(network: nn.Module, learning_rate: float) -> torch.optim.Optimizer:
    """Returns the optimiser of a network."""
    return torch.optim.Adam(network.parameters(), learning_rate)


def propose(
    setter: RealNVP, latents: NDArray[np.float64], feasibility: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Returns points (n, d) of a feasibility (n,) each, from noise (n, d)."""
    with inference():
        points, _ = setter(torch.from_numpy(latents), torch.from_numpy(feasibility))
    proposed: NDArray[np.float64] = points.numpy()
    return proposed


def update_judge(
    judge: nn.Sequential,
    optimiser: torch.optim.Optimizer,
    points: NDArray[np.float64],
    solved: NDArray[np.bool_],
) -> float:
    """Takes one step towards the successes (n,) on points (n, d); returns the loss."""
    with training():
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
    """Takes one step; returns the losses.

    Args:
        setter: what is trained.
        judge: what tells the feasibility of its points.
        optimiser: of the setter.
        proposed: noise (n, d) and feasibility (n,) that were proposed from.
        valid: points (m, d) that were solved, with noise, and which (n,) of the proposed these are.
    """
    latents, feasibility = proposed
    targets, solved = valid
    with training():
        wanted = torch.from_numpy(feasibility)
        points, log_density = setter(torch.from_numpy(latents), wanted)
        judged = judge(points)[:, 0]
        losses = {
            "feasibility_loss": ((judged - torch.logit(wanted)) ** 2).mean(),
            "coverage_loss": log_density.mean(),
        }
        if len(targets):
            _, likelihood = setter.inverse(torch.from_numpy(targets), wanted[torch.from_numpy(solved)])
            losses["validity_loss"] = -likelihood.mean()
        descend(optimiser, torch.stack(list(losses.values())).sum())
    return {name: loss.item() for name, loss in losses.items()}


def _judge(size: int, generator: torch.Generator) -> nn.Sequential:
    """Returns three hidden layers (paper, appendix A) and the logit of success."""
    widths = [size, JUDGE_UNITS, JUDGE_UNITS, JUDGE_UNITS]
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [linear(inputs, outputs, DTYPE, generator), nn.ReLU()]
    return nn.Sequential(*layers, linear(JUDGE_UNITS, 1, DTYPE, generator))
