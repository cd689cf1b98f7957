"""Draws a world: ground, ceiling, creepers, water, goal and the way to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.envs.drawing.palette import CREEPER, CREEPER_EDGE, Colour, GOAL, HEAD, MARK, OUTLINE, ROCK, ROCK_EDGE, SOIL, SOIL_EDGE, TRACK, WATER, WATER_EDGE
from tma_ray.envs.drawing.camera import height_at
from tma_ray.envs.drawing.canvas import Canvas
from tma_ray.envs.drawing.scene import Scene
from tma_ray.terrain import GROUND_HEIGHT, Terrain

FLAGPOLE = 3.2
"""Height of the goal's flag, in m."""

MARK_SPACING = 5
"""Distance between marks on the ground, in m."""

Floats = NDArray[np.float64]


def draw_goal(canvas: Canvas, terrain: Terrain) -> None:
    """Draws a flag on the ground at the goal."""
    foot = np.array([terrain.goal_x, _base(terrain, terrain.goal_x)])
    top = foot + np.array([0.0, FLAGPOLE])
    canvas.line(np.stack([foot, top]), OUTLINE, 3)
    canvas.fill(top + np.array([[0.0, 0.0], [1.0, -0.35], [0.0, -0.7]]), GOAL, OUTLINE)


def draw_world(canvas: Canvas, scene: Scene) -> None:
    """Draws water, creepers, and ground and ceiling with the distances from the start."""
    terrain = scene.terrain
    canvas.tint(terrain.water_y, WATER, 120)
    edge = np.array([[canvas.view.left, terrain.water_y], [canvas.view.right, terrain.water_y]])
    if canvas.view.bottom < terrain.water_y < canvas.view.top:
        canvas.line(edge, WATER_EDGE, 1)
    _draw_creepers(canvas, scene)  # before the solids, into which they reach where the ceiling slopes
    split = terrain.ground_solids
    _draw_solids(canvas, terrain.solids[:split], terrain.surface, SOIL, SOIL_EDGE)
    _draw_solids(canvas, terrain.solids[split:], terrain.ceiling, ROCK, ROCK_EDGE)
    first = int(canvas.view.left) // MARK_SPACING * MARK_SPACING
    for mark in range(first, int(canvas.view.right) + 1 + MARK_SPACING, MARK_SPACING):
        place = np.array([float(mark), _base(terrain, mark) - 0.25])
        if place[1] > canvas.view.bottom:
            canvas.text(place, f"{mark} m", MARK)


def draw_water(canvas: Canvas, water_y: float) -> None:
    """Tints everything under water."""
    canvas.tint(water_y, WATER, 60)


def draw_progress(canvas: Canvas, head_x: float, terrain: Terrain) -> None:
    """Draws how far the head is between spawn point and goal, along the top."""
    start, goal = terrain.spawn[0], terrain.goal_x
    share = float(np.clip((head_x - start) / (goal - start), 0, 1))
    canvas.bar(share, (TRACK, HEAD, GOAL))


def _draw_solids(
    canvas: Canvas, solids: Floats, surface: Floats, colour: Colour, edge: Colour
) -> None:
    for corners in solids[canvas.sees(solids[..., 0].min(1), solids[..., 0].max(1))]:
        canvas.fill(corners, colour)
    for ends in surface[canvas.sees(surface[:, 0], surface[:, 2])].reshape(-1, 2, 2):
        canvas.line(ends, edge, 2)


def _draw_creepers(canvas: Canvas, scene: Scene) -> None:
    sizes = scene.terrain.creepers[:, 2:] - scene.terrain.creepers[:, :2]
    reach = np.hypot(*sizes.T) / 2
    seen = canvas.sees(scene.creepers[:, 0] - reach, scene.creepers[:, 0] + reach)
    for (x, y, cosine, sine), size in zip(scene.creepers[seen], sizes[seen], strict=True):
        corners = size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        turned = corners @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])
        canvas.fill(turned, CREEPER, CREEPER_EDGE)


def _base(terrain: Terrain, x: float) -> float:
    """Returns the height of the ground at `x` in m, under any stumps."""
    return float(height_at(terrain.surface, x)) if len(terrain.ceiling) else GROUND_HEIGHT
