"""Torch for teachers: seeded from numpy, on one CPU thread, with nothing global changed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import nn

from tma_ray.optimisers import leave_compiler_out, take_step

leave_compiler_out()


def torch_generator(rng: np.random.Generator) -> torch.Generator:
    """Returns a generator for initial weights, seeded by a draw from `rng`."""
    return torch.Generator().manual_seed(int(rng.integers(2**63)))


def linear(inputs: int, outputs: int, dtype: torch.dtype, generator: torch.Generator) -> nn.Linear:
    """Returns a layer with Xavier's uniform weights (Glorot and Bengio 2010) and no bias yet."""
    layer = nn.Linear(inputs, outputs, device="meta", dtype=dtype)  # draws no weights of its own
    layer.weight, layer.bias = (
        nn.Parameter(torch.empty(parameter.shape, dtype=dtype)) for parameter in (layer.weight, layer.bias)
    )
    nn.init.xavier_uniform_(layer.weight, generator=generator)
    nn.init.zeros_(layer.bias)
    return layer


def descend(optimiser: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    """Takes one step of `optimiser` down the gradient of `loss`."""
    for group in optimiser.param_groups:
        for parameter in group["params"]:
            parameter.grad = None
    loss.backward()  # type: ignore[no-untyped-call]
    take_step(optimiser)


@contextmanager
def training() -> Iterator[None]:
    """Computes gradients on one thread inside the block, so that where a teacher runs changes nothing."""
    with single_thread(), torch.enable_grad():
        yield


@contextmanager
def inference() -> Iterator[None]:
    """Computes no gradients inside the block, on one thread."""
    with single_thread(), torch.no_grad():
        yield


@contextmanager
def single_thread() -> Iterator[None]:
    """Uses one thread inside the block, and as many as before after it."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
