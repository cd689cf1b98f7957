"""Demands of Parkour's worlds on each type of body, used to select and order test tasks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.terrain import Terrain
from tma_ray.terrain.terrain import STARTPAD_STEPS, TERRAIN_STEP

Floats = NDArray[np.float64]

WINDOW_STEPS = 5
"""Terrain steps over which rises and drops are measured: 2.33 m, about a classic bipedal walker's length."""

WALKER_RISE = 1.4
"""Greatest rise within the window, in m: the highest stump of Stump Tracks' task space."""

WALKER_DROP = 6.0
"""Greatest drop within the window, in m: twice a classic bipedal walker's height; it may fall over."""

WALKER_CLEARANCE = 3.0
"""Smallest height of the passage, in m: the classic bipedal walker is 2.73 m high."""

WALKER_DEPTH = 1.5
"""Greatest depth of water, in m: the head of a standing classic bipedal walker is at 2.37 m."""

SWIMMER_CLEARANCE = 1.6
"""Smallest height of the passage under water, in m: twice the height of the fish."""

SWIMMER_CLIMB = 10.0
"""Greatest rise or drop within the window on the smoothest path through the passage, in m."""

SWIMMER_DETOUR = 100.0
"""Greatest total rise and fall of the smoothest path, in m: as much as its horizontal length."""

CLIMBER_CLEARANCE = 5.2
"""Smallest height of the passage, in m: a stretched climbing chimpanzee reaches 5.13 m from grip to foot."""

CLIMBER_AIR = 2.0
"""Smallest height of air under the ceiling, in m: the hanging head is 1.6 m under the grips."""

CLIMBER_CLIMB = 8.0
"""Greatest rise or drop of the ceiling within the window, in m."""

CLIMBER_GAP = 4.0
"""Smallest gap between creepers that are of no help, in m: the span of both arms; the ceiling remains."""


def demands(terrain: Terrain, body_type: str) -> dict[str, float]:
    """Return the demands of a terrain on a type of body between start and goal; over 1 is not feasible.

    Args:
        terrain: a world of Parkour.
        body_type: "walker" (classic bipedal), "swimmer" (fish) or "climber" (climbing chimpanzee).

    Raises:
        ValueError: if the type of body is another one.
    """
    if body_type not in _DEMANDS:
        raise ValueError(f"body type {body_type!r}: expected one of {', '.join(_DEMANDS)}")
    # heights from the end of the flat start to the goal, one per terrain step
    left = terrain.surface[:, 0]
    track = (left > (STARTPAD_STEPS - 0.5) * TERRAIN_STEP) & (left < terrain.goal_x + 0.5 * TERRAIN_STEP)
    return _DEMANDS[body_type](terrain, terrain.surface[track, 1], terrain.ceiling[track, 1])


def difficulty(demanded: dict[str, float]) -> float:
    """Return the mean demand, or infinity if a demand is over 1."""
    values = list(demanded.values())
    return float(np.mean(values)) if max(values) <= 1 else np.inf


def smoothest_path(low: Floats, high: Floats) -> Floats:
    """Return the path (n,) between `low` and `high` (n,) with the least total rise and fall.

    It begins in the middle of the first gap.
    """
    way = np.empty(len(low))
    height = (low[0] + high[0]) / 2
    for place, (floor, roof) in enumerate(zip(low, high, strict=True)):
        height = min(max(height, floor), roof)
        way[place] = height
    return way


def greatest_rise(heights: Floats) -> float:
    """Return the greatest rise of `heights` (n,), one per terrain step, within `WINDOW_STEPS`; 0 if none."""
    rises = [(heights[steps:] - heights[:-steps]).max() for steps in range(1, WINDOW_STEPS + 1)]
    return max(0.0, float(max(rises)))


def _of_walkers(terrain: Terrain, ground: Floats, ceiling: Floats) -> dict[str, float]:
    return {
        "rise": greatest_rise(ground) / WALKER_RISE,
        "drop": greatest_rise(ground[::-1]) / WALKER_DROP,
        "clearance": _narrowness(WALKER_CLEARANCE, ceiling - ground),
        "depth": max(0.0, terrain.water_y - float(ground.min())) / WALKER_DEPTH,
    }


def _of_swimmers(terrain: Terrain, ground: Floats, ceiling: Floats) -> dict[str, float]:
    roof = np.minimum(ceiling, terrain.water_y)
    half = SWIMMER_CLEARANCE / 2
    way = smoothest_path(ground + half, np.maximum(roof - half, ground + half))
    return {
        "clearance": _narrowness(SWIMMER_CLEARANCE, roof - ground),
        "climb": max(greatest_rise(way), greatest_rise(way[::-1])) / SWIMMER_CLIMB,
        "detour": float(np.abs(np.diff(way)).sum()) / SWIMMER_DETOUR,
    }


def _of_climbers(terrain: Terrain, ground: Floats, ceiling: Floats) -> dict[str, float]:
    gaps = np.diff(np.unique([0.0, *terrain.creepers[:, 0], terrain.goal_x]))
    return {
        "clearance": _narrowness(CLIMBER_CLEARANCE, ceiling - ground),
        "water": _narrowness(CLIMBER_AIR, ceiling - terrain.water_y),
        "climb": max(greatest_rise(ceiling), greatest_rise(ceiling[::-1])) / CLIMBER_CLIMB,
        "creepers": min(1.0, float(gaps.max()) / CLIMBER_GAP),
    }


_DEMANDS = {"walker": _of_walkers, "swimmer": _of_swimmers, "climber": _of_climbers}


def _narrowness(needed: float, heights: Floats) -> float:
    """Return the ratio of `needed` to the smallest of `heights` (n,), infinite if that is not positive."""
    smallest = float(heights.min())
    return needed / smallest if smallest > 0 else np.inf
