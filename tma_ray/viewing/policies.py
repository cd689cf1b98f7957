"""Untrained policies: uniformly random actions, and all zero."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from tma_ray.runs.saved_policies import StepPolicy

RANDOM, ZERO = "random", "zero"
"""Names of the untrained policies."""


def random_policy(actions: spaces.Box, rng: np.random.Generator) -> StepPolicy:
    """Returns a policy whose actions are uniform, whatever it observes."""
    return lambda _: rng.uniform(actions.low, actions.high).astype(np.float32)


def zero_policy(actions: spaces.Box) -> StepPolicy:
    """Returns a policy whose actions are all zero."""
    return lambda _: np.zeros(actions.shape, np.float32)
