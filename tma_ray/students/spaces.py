"""The spaces that students can act in. Imports no torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import Space, spaces


def checked_spaces(observation_space: Space[Any], action_space: Space[Any]) -> tuple[spaces.Box, spaces.Box]:
    """Returns both spaces.

    Raises:
        ValueError: a space that is not a one-dimensional float32 box, or unbounded actions.
    """
    boxes = _checked_box(observation_space, "observation"), _checked_box(action_space, "action")
    if not boxes[1].is_bounded():
        raise ValueError(f"action space {boxes[1]}: expected finite bounds")
    return boxes


def _checked_box(space: Space[Any], kind: str) -> spaces.Box:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or space.dtype != np.float32:
        raise ValueError(f"{kind} space {space}: expected a one-dimensional float32 Box")
    return space
