"""Rows of stacks: views of what belongs to one run, with which it is updated alone."""

from __future__ import annotations

from copy import copy
from typing import TypeVar

import torch

T = TypeVar("T")


def narrowed(owner: T, slot: int, *names: str) -> T:
    """Returns a shallow copy of `owner` with views of one slot's row (1, ...) of the tensors `names`."""
    own = copy(owner)
    for name in names:
        setattr(own, name, getattr(owner, name)[slot : slot + 1])
    return own


def leaf(parameters: torch.Tensor, slot: int) -> torch.Tensor:
    """Returns the row of a slot as a leaf of autograd (1, ...), in the same memory."""
    return parameters.detach()[slot : slot + 1].requires_grad_()
