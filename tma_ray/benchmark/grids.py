"""Values of hyper-parameters to search, and what the paper chose."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Grid:
    """Every combination of some values of hyper-parameters.

    Attributes:
        values: to try, by hyper-parameter.
        chosen: the combination that the paper chose; one of the grid's.

    Raises:
        ValueError: the chosen combination is not in the grid.
    """

    values: Mapping[str, tuple[Any, ...]]
    chosen: Mapping[str, Any]

    def __post_init__(self) -> None:
        if dict(self.chosen) not in self._combinations():
            raise ValueError(
                f"the choice {dict(self.chosen)} is not in the grid; expected values from {dict(self.values)}"
            )

    def points(self, most: int | None = None) -> tuple[dict[str, Any], ...]:
        """Returns the paper's choice, then the other combinations, the last hyper-parameter changing fastest.

        Args:
            most: how many, evenly spread over the grid after the choice; None for all.
        """
        others = [point for point in self._combinations() if point != dict(self.chosen)]
        count = len(others) if most is None else min(max(most - 1, 0), len(others))
        spread = (others[place * len(others) // count] for place in range(count))
        return (dict(self.chosen), *spread)

    def _combinations(self) -> list[dict[str, Any]]:
        combinations = itertools.product(*self.values.values())
        return [dict(zip(self.values, point, strict=True)) for point in combinations]


TEACHER_GRIDS: Mapping[str, Grid] = {
    "adr": Grid(
        {
            "shrink_at": (0.0, 50.0),
            "expand_at": (180.0, 230.0, 280.0),
            "boundary_share": (0.3, 0.5, 0.7),
            "queue_size": (10, 20),
            "step": (0.05, 0.1),
        },
        chosen={
            "shrink_at": 0.0,
            "expand_at": 180.0,
            "boundary_share": 0.7,
            "queue_size": 10,
            "step": 0.1,
        },
    ),
    "riac": Grid(
        {
            "region_capacity": (50, 150, 250, 350),
            "split_attempts": (25, 50, 75, 100),
            "smallest_side": (0.0677, 0.1, 0.1677, 0.2),
        },
        chosen={"region_capacity": 150, "split_attempts": 75, "smallest_side": 0.1},
    ),
    "covar_gmm": Grid(
        {
            "fit_every": (50, 150, 250, 350),
            "most_components": (5, 10, 15, 20),
            "explore": (0.05, 0.1, 0.2, 0.3),
        },
        chosen={"fit_every": 150, "most_components": 15, "explore": 0.1},
    ),
    "alp_gmm": Grid(
        {
            "fit_every": (50, 150, 250, 350),
            "most_components": (5, 10, 15, 20),
            "explore": (0.05, 0.1, 0.2, 0.3),
        },
        chosen={"fit_every": 150, "most_components": 10, "explore": 0.05},
    ),
    "goal_gan": Grid(
        {
            "noise": (0.01, 0.05, 0.1),
            "train_every": (100, 200, 300),
            "old_share": (0.1, 0.2, 0.3),
            "rollouts": (2, 5, 10),
        },
        chosen={"noise": 0.01, "train_every": 100, "old_share": 0.2, "rollouts": 2},
    ),
    "spdl": Grid(
        {
            "first_update": (100_000, 200_000),
            "update_every": (50_000, 100_000),
            "updates_without_penalty": (0, 5, 10),
            "penalty_share": (0.05, 0.25, 0.5),
            "most_divergence": (0.1, 0.8),
        },
        chosen={
            "first_update": 200_000,
            "update_every": 100_000,
            "updates_without_penalty": 0,
            "penalty_share": 0.05,
            "most_divergence": 0.8,
        },
    ),
    "setter_solver": Grid(
        {
            "update_every": (50, 100, 200, 300),
            "noise": (0.005, 0.01, 0.05, 0.1),
            "hidden_units": (64, 128, 256, 512),
        },
        chosen={"update_every": 100, "noise": 0.05, "hidden_units": 128},
    ),
}
"""What the paper tried of each teacher (appendix on hyper-parameters): 64 to 81 combinations."""

PPO_GRID = Grid(
    {
        "steps_per_update": (1_000, 2_000, 4_000),
        "epochs": (5, 10),
        "learning_rate": (1e-4, 3e-4, 1e-3),
        "batch_size": (500, 1_000),
        "value_coefficient": (0.5, 1.0),
        "entropy_coefficient": (0.0, 0.01),
    },
    chosen={
        "steps_per_update": 2_000,
        "epochs": 5,
        "learning_rate": 3e-4,
        "batch_size": 1_000,
        "value_coefficient": 0.5,
        "entropy_coefficient": 0.0,
    },
)
"""Of PPO the paper names the hyper-parameters that it searched and what it chose (appendix on students), not
what else it tried: the other values are ours, about the chosen ones."""
