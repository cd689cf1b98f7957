"""Policies that nobody trained: uniformly random actions, and none."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from tma_ray.runs.saved_policies import Player

RANDOM, ZERO = "random", "zero"
"""Names of the untrained policies."""


def random_player(actions: spaces.Box, rng: np.random.Generator) -> Player:
    """Returns a player whose actions are uniform, whatever it observes."""
    return lambda _: rng.uniform(actions.low, actions.high).astype(np.float32)


def zero_player(actions: spaces.Box) -> Player:
    """Returns a player that does nothing."""
    return lambda _: np.zeros(actions.shape, np.float32)
