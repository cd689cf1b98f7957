"""SAC's exploring action in one compiled call: network, noise and squashing. Imports no torch."""

from __future__ import annotations

import numpy as np

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations
from tma_ray.students.mlp.rows import FloatArray, RowArrays, apply_row


@kernel
def squashed_action(
    network: RowArrays, observation: Observations, noise: FloatArray, lowest: float, highest: float
) -> Actions:
    """Returns the tangent hyperbolic (a,) of a normal variable.

    Args:
        network: whose outputs are means and log deviations.
        observation: (o,).
        noise: standard normal (a,).
        lowest: bound of the log deviation.
        highest: likewise.
    """
    weights, sizes, work, active = network
    outputs = apply_row(weights, sizes, work, active, observation)
    count = len(noise)
    actions = np.empty_like(noise)
    for k in range(count):
        deviation = np.exp(min(max(outputs[count + k], np.float32(lowest)), np.float32(highest)))
        actions[k] = np.tanh(outputs[k] + deviation * noise[k])
    return actions
