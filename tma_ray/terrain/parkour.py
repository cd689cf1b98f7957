"""Parkour: ground and ceiling drawn by a network, creepers, water (paper, appendix B)."""

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.support.jit import kernel
from tma_ray.support.npz import load_npz
from tma_ray.tasks import Task
from tma_ray.terrain.base import CEILING, FIXED, GROUND_HEIGHT, STARTPAD_STEPS, STEP, Terrain

POINTS = 200
"""Points of a curve; the network's x runs from 0 to 1 over them."""

INPUTS = 3
"""Size of theta, the part of a task that chooses the curves."""

UNITS = 64
"""Units of each of the four hidden layers."""

SHAPES = {
    "w1": (1 + INPUTS, UNITS),
    "w2": (UNITS, UNITS),
    "w3": (UNITS, UNITS),
    "w4": (UNITS, UNITS),
    "w5": (UNITS, 2),
}
"""Names and shapes of the weight matrices, from the input [x, theta] to the output [ground, ceiling]."""

BLOCK = 50
"""Points that pass the network together: too few for BLAS to spread over threads, which for so small products
takes longer, and so the same bits with any number of threads."""

DEFAULT_WEIGHTS = Path(__file__).parent / "data" / "cppn.npz"
"""Weights shipped with the package, found by docs/making/search_cppn_weights.py."""

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CPPN:
    """A compositional pattern-producing network with fixed weights.

    Four hidden layers, tanh and softplus in turn, a linear output, no biases; all in float32. Its outputs
    are heights before they are scaled and aligned to the start.

    Source: paper, appendix B. It draws weights from N(0, 1), the original release from a normal
    distribution of standard deviation 2 cut at two standard deviations.

    Attributes:
        weights: float32 matrices by name, of `SHAPES`.
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
        """Return the network whose weights are the arrays w1 to w5 of a ``.npz`` file; others are ignored.

        Raises:
            ValueError: no such file, no such arrays in it, or of other shapes.
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
        """Return ground and ceiling for `theta` (..., 3): heights (..., 200, 2), not scaled or aligned."""
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
        """Contribution of x, alike in all tasks, to the first layer (blocks, 50, 64)."""
        x = np.arange(POINTS, dtype=np.float32) / np.float32(POINTS - 1)
        return np.outer(x, self.weights["w1"][0]).reshape(-1, BLOCK, UNITS)


def softplus(values: Singles) -> Singles:
    """Return log(1 + exp(values)), exact to float32's resolution at 1, without overflow."""
    result = np.exp(-np.abs(values))
    result += np.float32(1)
    np.log(result, out=result)
    result += np.maximum(values, np.float32(0))
    return result


TRACK_POINTS = STARTPAD_STEPS + POINTS
"""Points of ground and ceiling, one a terrain step from x = 0 on."""

GOAL_X = (TRACK_POINTS - 5) * STEP
"""x of the goal, in m."""

CEILING_OFFSET = 200.0
"""Height of the start's ceiling over its ground, in the network's unit: in m after division by delta."""

GROUND_LIMIT = -1000.0
"""Height of a water level of 0, in the network's unit."""

MINIMUM_WATER_LEVEL = 0.01
"""Water level under which no water stands."""

CREEPER_HEIGHT_STD = 0.1
"""Standard deviation of creepers' heights around the task's mean, in m."""

MINIMUM_CREEPER_HEIGHT = 0.2
"""Smallest height of a creeper, and of a part of a swinging one, in m."""

MINIMUM_CREEPER_WIDTH = 0.2
"""Smallest width of a creeper, in m."""

MINIMUM_CREEPER_SPACING = 0.01
"""Smallest gap between two creepers before it is rounded up to terrain steps, in m."""

CREEPER_PART_HEIGHT = 1.0
"""Height of the parts that a swinging creeper is cut into, in m."""

FRICTION = 2.5
"""Friction coefficient of ground and ceiling."""

MARGIN = 20.0
"""How far ground and ceiling reach past both ends of the track, in m: over any lidar and any fall."""

DEPTH = 10.0
"""How far solids reach under the ground's lowest and over the ceiling's highest point, in m."""

Floats = NDArray[np.float64]


def _scattered(count: int) -> NDArray[np.int64]:
    """Return the numbers below `count`, neighbours far apart: sorted by their reversed bits."""
    bits = count.bit_length()
    return np.array(sorted(range(count), key=lambda number: f"{number:0{bits}b}"[::-1]))


COLUMNS = POINTS + 1
"""Solids of the ground, and of the ceiling: one for the start, for every column, and for the end."""

INSERTION_ORDER = np.concatenate([_scattered(COLUMNS), COLUMNS + _scattered(COLUMNS)])
"""Order of the solids: Chipmunk's search tree is built three times as fast as from left to right."""


def parkour(task: Task, rng: np.random.Generator, *, cppn: CPPN, swinging_creepers: bool = False) -> Terrain:
    """Return the world of `task`.

    Args:
        task: theta (3), water level in [0, 1], creepers' width, mean height and spacing in m, and delta, by
            which the network's heights are divided.
        rng: source of one height per creeper.
        cppn: network of ground and ceiling.
        swinging_creepers: True for creepers that are chains of swinging parts (not used in the paper).
    """
    water_level, width, height, spacing, delta = (float(value) for value in task[3:])
    ground, ceiling = outlines(task[:3], delta, cppn)
    solids, surface, underside = _lay_out(ground, ceiling)
    points, heights = creeper_points(width, spacing), np.zeros(TRACK_POINTS)
    heights[points] = np.maximum(MINIMUM_CREEPER_HEIGHT, rng.normal(height, CREEPER_HEIGHT_STD, len(points)))
    # a creeper hangs from the higher of the ceiling's points at its sides
    tops = np.maximum(ceiling, np.roll(ceiling, -_points_over(width)))
    part_height, holder = (CREEPER_PART_HEIGHT, CEILING) if swinging_creepers else (heights.max(), FIXED)
    creepers, holders = _cut(tops, heights, max(MINIMUM_CREEPER_WIDTH, width), part_height, holder)
    return Terrain(
        solids[INSERTION_ORDER],
        FRICTION,
        surface,
        spawn=np.array([STARTPAD_STEPS * STEP / 2, GROUND_HEIGHT]),
        goal_x=GOAL_X,
        ground_solids=len(surface),
        ceiling=underside,
        creepers=creepers,
        holders=holders,
        water_y=water_height(water_level, delta, ceiling),
    )


def outlines(theta: Task, delta: float, cppn: CPPN) -> tuple[Floats, Floats]:
    """Return the heights of ground and ceiling (220,) in m, one a terrain step from x = 0 on.

    Behind a flat start, both follow the network, divided by `delta` and shifted to meet the start. Where the
    ceiling would then be under the ground, it lies on it: the passage is closed.
    """
    curves = cppn.curves(theta).astype(np.float64) / delta
    track = np.zeros((TRACK_POINTS, 2))
    track[STARTPAD_STEPS:] = curves - curves[0]
    ground = GROUND_HEIGHT + track[:, 0]
    ceiling = GROUND_HEIGHT + CEILING_OFFSET / delta + track[:, 1]
    return ground, np.maximum(ceiling, ground)


def water_height(level: float, delta: float, ceiling: Floats) -> float:
    """Return the height of the water's surface in m.

    It rises with `level` from `GROUND_LIMIT`, far under any ground, to the highest point of the `ceiling`.
    """
    bottom = GROUND_LIMIT / delta
    return bottom + max(MINIMUM_WATER_LEVEL, level) * (float(ceiling.max()) - bottom)


def creeper_points(width: float, spacing: float) -> NDArray[np.int64]:
    """Return the points of the track at which creepers have their left sides, the start included.

    Between two left sides lie the spacing, rounded up to terrain steps, and one terrain step more, whatever
    the width.
    """
    period = math.ceil(max(MINIMUM_CREEPER_SPACING, spacing) / STEP) + 1
    return np.arange(0, TRACK_POINTS - _points_over(width), period)


def _points_over(width: float) -> int:
    """Return the number of points, at least 1, between the left side of a creeper of `width` and its end."""
    return max(1, int(max(MINIMUM_CREEPER_WIDTH, width) / STEP))


@kernel
def _cut(
    tops: Floats, heights: Floats, width: float, part_height: float, first_holder: int
) -> tuple[Floats, NDArray[np.int64]]:
    """Return creepers of `heights` (n,) under `tops` (n,) in parts of `part_height`, and their holders.

    A last part that would be too low is as high as the lowest creeper.
    """
    count = int(np.ceil(heights / part_height).sum())
    creepers, holders = np.empty((count, 4)), np.empty(count, np.int64)
    part = 0
    for point in range(len(heights)):
        top, left, holder = tops[point], heights[point], first_holder
        while left > 0:
            height = max(MINIMUM_CREEPER_HEIGHT, min(part_height, left))
            creepers[part, 0], creepers[part, 1] = point * STEP, top - height
            creepers[part, 2], creepers[part, 3] = point * STEP + width, top
            holders[part] = holder
            holder = part
            part += 1
            top -= height
            left -= height
    return creepers, holders


@kernel
def _lay_out(ground: Floats, ceiling: Floats) -> tuple[Floats, Floats, Floats]:
    """Return solids, surface and underside: one each for the start, for every column, and for the end."""
    count = len(ground) - STARTPAD_STEPS + 1
    solids, surface, underside = np.empty((2 * count, 4, 2)), np.empty((count, 4)), np.empty((count, 4))
    bottom, top = ground.min() - DEPTH, ceiling.max() + DEPTH
    for index in range(count):
        first, last = index + STARTPAD_STEPS - 1, index + STARTPAD_STEPS
        left, right = first * STEP, last * STEP
        if index == 0:
            first, left = 0, -MARGIN
        if index == count - 1:
            last, right = first, left + MARGIN
        surface[index] = np.array((left, ground[first], right, ground[last]))
        underside[index] = np.array((left, ceiling[first], right, ceiling[last]))
        _fill_column(solids[index], left, right, (bottom, bottom), (ground[first], ground[last]))
        _fill_column(solids[count + index], left, right, (ceiling[first], ceiling[last]), (top, top))
    return solids, surface, underside


@kernel
def _fill_column(
    corners: Floats, left: float, right: float, low: tuple[float, float], high: tuple[float, float]
) -> None:
    """Write the corners (4, 2) of a solid between the heights `low` and `high` of its left and right."""
    corners[0, 0], corners[0, 1] = left, low[0]
    corners[1, 0], corners[1, 1] = right, low[1]
    corners[2, 0], corners[2, 1] = right, high[1]
    corners[3, 0], corners[3, 1] = left, high[0]
