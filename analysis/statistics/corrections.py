"""Corrections of p-values for many tests at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Returns Holm's adjustment of `p_values` (n,) for testing n hypotheses at once; NaN stays NaN.

    Raises:
        ValueError: a value is outside [0, 1].
    """
    values = np.asarray(p_values, dtype=np.float64)
    wrong = values[(values < 0) | (values > 1)]
    if wrong.size:
        raise ValueError(f"p = {wrong[0]:g}: expected values in [0, 1]")
    adjusted = np.full(values.shape, np.nan)
    order = np.argsort(values)[: np.isfinite(values).sum()]  # NaN sorts last
    steps = values[order] * np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted
