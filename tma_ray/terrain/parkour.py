"""Parkour: ground and ceiling from a network, creepers and water (paper, appendix B)."""

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.support.decoding import load_npz
from tma_ray.support.jit import kernel
from tma_ray.tasks import Task
from tma_ray.terrain.terrain import (
    CEILING,
    DEPTH,
    FIXED,
    FRICTION,
    GROUND_HEIGHT,
    OVERHANG,
    STARTPAD_STEPS,
    TERRAIN_STEP,
    Terrain,
)

POINTS = 200  # number of points of a curve, along which the network's x runs from 0 to 1
INPUTS = 3  # size of theta, the part of a task that chooses the curves
UNITS = 64  # size of each of the four hidden layers

SHAPES = {
    "w1": (1 + INPUTS, UNITS),
    "w2": (UNITS, UNITS),
    "w3": (UNITS, UNITS),
    "w4": (UNITS, UNITS),
    "w5": (UNITS, 2),
}
"""Names and shapes of the weight matrices, from the input [x, theta] to the output [ground, ceiling]."""

BLOCK_POINTS = 50  # rows of a matrix product: too few for BLAS to use threads, which would change bits

DEFAULT_WEIGHTS = Path(__file__).parent / "data" / "cppn.npz"  # found by docs/making/search_cppn_weights.py

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CPPN:
    """Compositional pattern-producing network (CPPN) with fixed weights.

    Four hidden layers with tanh and softplus in turn, a linear output and no biases, in float32. The outputs
    are heights before scaling and alignment with the start.

    Source: paper, appendix B, which draws weights from N(0, 1); the original release draws them from N(0, 4)
    truncated at two standard deviations.

    Attributes:
        weights: float32 matrices by name, of the shapes in `SHAPES`.
    """

    weights: Mapping[str, Singles]

    def __post_init__(self) -> None:
        for name, shape in SHAPES.items():
            if name not in self.weights:
                raise ValueError(f"weights {name!r} are missing: expected {', '.join(SHAPES)}")
            matrix = self.weights[name]
            if matrix.shape != shape or not np.all(np.isfinite(matrix)):
                raise ValueError(
                    f"weights {name!r} of shape {matrix.shape}: expected finite numbers of shape {shape}"
                )

    @classmethod
    def load(cls, path: str | Path = DEFAULT_WEIGHTS) -> "CPPN":
        """Load the weights from the arrays w1 to w5 of an ``.npz`` file.

        Raises:
            ValueError: if the file is missing or its arrays are missing or of other shapes.
        """
        try:
            arrays = load_npz(Path(path))
            return cls({name: arrays[name].astype(np.float32) for name in SHAPES if name in arrays})
        except FileNotFoundError as error:
            raise ValueError(f"no file of CPPN weights {str(path)!r}") from error
        except (zipfile.BadZipFile, EOFError, AttributeError, TypeError) as error:
            raise ValueError(f"{path} is not an .npz file of CPPN weights") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    def curves(self, theta: ArrayLike) -> Singles:
        """Return unscaled heights of ground and ceiling (..., 200, 2) for `theta` (..., 3)."""
        values = np.asarray(theta, dtype=np.float32)
        w1, w2, w3, w4, w5 = (self.weights[name] for name in SHAPES)
        signal: Singles = self._from_x + (values @ w1[1:])[..., None, None, :]
        np.tanh(signal, out=signal)
        signal = softplus(signal @ w2)
        signal = signal @ w3
        np.tanh(signal, out=signal)
        curves: Singles = softplus(signal @ w4) @ w5
        return curves.reshape(*values.shape[:-1], POINTS, 2)

    @cached_property
    def _from_x(self) -> Singles:
        """Contribution of x to the first layer (blocks, 50, 64), which is the same for all tasks."""
        x = np.arange(POINTS, dtype=np.float32) / np.float32(POINTS - 1)
        return np.outer(x, self.weights["w1"][0]).reshape(-1, BLOCK_POINTS, UNITS)


def softplus(values: Singles) -> Singles:
    """Return log(1 + exp(values)) in float32 without overflow."""
    result = np.exp(-np.abs(values))
    result += np.float32(1)
    np.log(result, out=result)
    result += np.maximum(values, np.float32(0))
    return result


TRACK_POINTS = STARTPAD_STEPS + POINTS  # points of ground and ceiling, one per terrain step from x = 0 on
GOAL_X = (TRACK_POINTS - 5) * TERRAIN_STEP  # in m

CEILING_OFFSET = 200.0  # height of the start's ceiling above the ground in the network's unit, 1 / delta m
GROUND_LIMIT = -1000.0  # height of a water level of 0, in the network's unit
MINIMUM_WATER_LEVEL = 0.01

CREEPER_HEIGHT_STD = 0.1  # standard deviation around the task's mean, in m
MINIMUM_CREEPER_HEIGHT = 0.2  # of a creeper or a part of a swinging one, in m
MINIMUM_CREEPER_WIDTH = 0.2  # in m
MINIMUM_CREEPER_SPACING = 0.01  # before rounding up to terrain steps, in m
CREEPER_PART_HEIGHT = 1.0  # of a part of a swinging creeper, in m

Floats = NDArray[np.float64]


def _scattered(count: int) -> NDArray[np.int64]:
    """Return the numbers below `count` in bit-reversed order."""
    bits = count.bit_length()
    return np.array(sorted(range(count), key=lambda number: f"{number:0{bits}b}"[::-1]))


COLUMNS = POINTS + 1  # solids of the ground, and of the ceiling: start, columns and end
INSERTION_ORDER = np.concatenate([_scattered(COLUMNS), COLUMNS + _scattered(COLUMNS)])
"""Order of the solids in which Chipmunk builds its search tree three times as fast as from left to right."""


def parkour(task: Task, rng: np.random.Generator, *, cppn: CPPN, swinging_creepers: bool = False) -> Terrain:
    """Return the terrain described by `task`.

    Args:
        task: theta (3), water level in [0, 1], creepers' width, mean height and spacing in m, and delta, the
            divisor of the network's heights.
        rng: source of one height per creeper.
        cppn: network of ground and ceiling.
        swinging_creepers: True for creepers that are chains of swinging parts (not used in the paper).
    """
    water_level, width, height, spacing, delta = (float(value) for value in task[3:])
    ground, ceiling = outlines(task[:3], delta, cppn)
    solids, surface, underside = _lay_out(ground, ceiling)
    points, heights = creeper_points(width, spacing), np.zeros(TRACK_POINTS)
    heights[points] = np.maximum(MINIMUM_CREEPER_HEIGHT, rng.normal(height, CREEPER_HEIGHT_STD, len(points)))
    # a creeper hangs from the higher of the two ceiling points at its sides
    tops = np.maximum(ceiling, np.roll(ceiling, -_points_over(width)))
    part_height, holder = (CREEPER_PART_HEIGHT, CEILING) if swinging_creepers else (heights.max(), FIXED)
    creepers, holders = _cut(tops, heights, max(MINIMUM_CREEPER_WIDTH, width), part_height, holder)
    return Terrain(
        solids[INSERTION_ORDER],
        FRICTION,
        surface,
        spawn=np.array([STARTPAD_STEPS * TERRAIN_STEP / 2, GROUND_HEIGHT]),
        goal_x=GOAL_X,
        ground_solids=len(surface),
        ceiling=underside,
        creepers=creepers,
        holders=holders,
        water_y=water_height(water_level, delta, ceiling),
    )


def outlines(theta: Task, delta: float, cppn: CPPN) -> tuple[Floats, Floats]:
    """Return the heights of ground and ceiling (220,) in m, one per terrain step from x = 0 on.

    Beyond the flat start, both follow the network, divided by `delta` and shifted to meet the start. A
    ceiling below the ground is raised to it, which closes the passage.
    """
    curves = cppn.curves(theta).astype(np.float64) / delta
    track = np.zeros((TRACK_POINTS, 2))
    track[STARTPAD_STEPS:] = curves - curves[0]
    ground = GROUND_HEIGHT + track[:, 0]
    ceiling = GROUND_HEIGHT + CEILING_OFFSET / delta + track[:, 1]
    return ground, np.maximum(ceiling, ground)


def water_height(level: float, delta: float, ceiling: Floats) -> float:
    """Return the height of the water's surface in m, between `GROUND_LIMIT` and the top of `ceiling`."""
    bottom = GROUND_LIMIT / delta
    return bottom + max(MINIMUM_WATER_LEVEL, level) * (float(ceiling.max()) - bottom)


def creeper_points(width: float, spacing: float) -> NDArray[np.int64]:
    """Return the indices of the track points at the left sides of creepers.

    The distance of two left sides is the spacing, rounded up to terrain steps, plus one terrain step.
    """
    period = math.ceil(max(MINIMUM_CREEPER_SPACING, spacing) / TERRAIN_STEP) + 1
    return np.arange(0, TRACK_POINTS - _points_over(width), period)


def _points_over(width: float) -> int:
    """Return the width of a creeper in whole terrain steps, at least 1."""
    return max(1, int(max(MINIMUM_CREEPER_WIDTH, width) / TERRAIN_STEP))


@kernel
def _cut(
    tops: Floats, heights: Floats, width: float, part_height: float, first_holder: int
) -> tuple[Floats, NDArray[np.int64]]:
    """Cut creepers of `heights` (n,) below `tops` (n,) into parts, and return the parts and their holders.

    A last part has at least the minimum height of a creeper.
    """
    count = int(np.ceil(heights / part_height).sum())
    creepers, holders = np.empty((count, 4)), np.empty(count, np.int64)
    part = 0
    for point in range(len(heights)):
        top, left, holder = tops[point], heights[point], first_holder
        while left > 0:
            height = max(MINIMUM_CREEPER_HEIGHT, min(part_height, left))
            creepers[part, 0], creepers[part, 1] = point * TERRAIN_STEP, top - height
            creepers[part, 2], creepers[part, 3] = point * TERRAIN_STEP + width, top
            holders[part] = holder
            holder = part
            part += 1
            top -= height
            left -= height
    return creepers, holders


@kernel
def _lay_out(ground: Floats, ceiling: Floats) -> tuple[Floats, Floats, Floats]:
    """Return solids, ground segments and ceiling segments for the start, each column, and the end."""
    count = len(ground) - STARTPAD_STEPS + 1
    solids, surface, underside = np.empty((2 * count, 4, 2)), np.empty((count, 4)), np.empty((count, 4))
    bottom, top = ground.min() - DEPTH, ceiling.max() + DEPTH
    for index in range(count):
        first, last = index + STARTPAD_STEPS - 1, index + STARTPAD_STEPS
        left, right = first * TERRAIN_STEP, last * TERRAIN_STEP
        if index == 0:
            first, left = 0, -OVERHANG
        if index == count - 1:
            last, right = first, left + OVERHANG
        surface[index] = np.array((left, ground[first], right, ground[last]))
        underside[index] = np.array((left, ceiling[first], right, ceiling[last]))
        _fill_column(solids[index], left, right, (bottom, bottom), (ground[first], ground[last]))
        _fill_column(solids[count + index], left, right, (ceiling[first], ceiling[last]), (top, top))
    return solids, surface, underside


@kernel
def _fill_column(
    corners: Floats, left: float, right: float, low: tuple[float, float], high: tuple[float, float]
) -> None:
    """Write the corners (4, 2) of a solid whose left and right sides extend from `low` to `high`."""
    corners[0, 0], corners[0, 1] = left, low[0]
    corners[1, 0], corners[1, 1] = right, low[1]
    corners[2, 0], corners[2, 1] = right, high[1]
    corners[3, 0], corners[3, 1] = left, high[0]
