"""Draws a body in its world with pygame: body, terrain, lidar rays, goal and progress."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, Part
from tma_ray.terrain import GROUND_HEIGHT, Terrain

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
import pygame
import pygame.gfxdraw

WIDTH, HEIGHT = 600, 400
"""Size of a frame, in pixels."""

PIXELS_PER_METRE = 48
SUPERSAMPLING = 2
HEAD_SHARE = 0.3
"""Where the camera keeps the head, as a share of the width: the lidars look ahead."""

GROUND_SHARE = 0.22
"""Height of the ground in the frame, as a share of the frame's, while the head is low enough."""

SKY_TOP, SKY_BOTTOM = (150, 190, 225), (236, 243, 247)
SOIL, SOIL_EDGE, MARK = (104, 122, 92), (66, 84, 60), (142, 158, 130)
HEAD, LIMB, FAR_LIMB, OUTLINE = (86, 98, 178), (126, 138, 212), (104, 110, 150), (42, 48, 96)
LIDAR, GOAL, TRACK = (214, 74, 62), (216, 66, 50), (120, 140, 158)

Floats = NDArray[np.float64]
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Scene:
    """What a frame shows.

    Attributes:
        poses: x, y, angle of every part's frame (p, 3), in m and rad.
        terrain: the world.
        lidars: where the rays end (r, 2), in m.
    """

    poses: Floats
    terrain: Terrain
    lidars: Floats


class Renderer:
    """Draws frames of one body.

    Args:
        body: whose shapes are drawn.
        window: whether frames are also shown, at the pace of the simulation.
        frames_per_second: pace of the window.
    """

    def __init__(self, body: Embodiment, window: bool, frames_per_second: int) -> None:
        self._body = body
        self._far = [_hidden(part, body.parts[:index]) for index, part in enumerate(body.parts)]
        self._frames_per_second = frames_per_second
        self._scale = PIXELS_PER_METRE * SUPERSAMPLING
        self._canvas = pygame.Surface((WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING))
        self._sky = _gradient(self._canvas.get_size(), SKY_TOP, SKY_BOTTOM)
        pygame.font.init()
        self._font = pygame.font.Font(None, 18 * SUPERSAMPLING)
        self._window: pygame.Surface | None = None
        if window:
            pygame.display.init()
            pygame.display.set_caption("tma_ray")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            self._clock = pygame.time.Clock()

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Returns the frame (400, 600, 3), or shows it and returns None if there is a window."""
        self._place_camera(scene)
        self._canvas.blit(self._sky, (0, 0))
        self._draw_goal(scene.terrain)
        self._draw_terrain(scene.terrain)
        self._draw_lidars(scene)
        self._draw_body(scene)
        self._draw_progress(scene)
        frame = pygame.transform.smoothscale(self._canvas, (WIDTH, HEIGHT))
        if self._window is None:
            return np.ascontiguousarray(pygame.surfarray.array3d(frame).transpose(1, 0, 2))
        self._window.blit(frame, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._frames_per_second)
        return None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None

    def _place_camera(self, scene: Scene) -> None:
        x, y = scene.poses[self._body.head, :2]
        height = HEIGHT / PIXELS_PER_METRE
        self._left = x - HEAD_SHARE * WIDTH / PIXELS_PER_METRE
        self._bottom = max(GROUND_HEIGHT - GROUND_SHARE * height, y - 0.8 * height)

    def _pixels(self, points: Floats) -> Floats:
        """Returns world `points` (..., 2) in pixels of the canvas."""
        x = (points[..., 0] - self._left) * self._scale
        y = HEIGHT * SUPERSAMPLING - (points[..., 1] - self._bottom) * self._scale
        return np.stack([x, y], axis=-1)

    def _visible(self, left: Floats, right: Floats) -> NDArray[np.bool_]:
        return np.asarray((right >= self._left) & (left <= self._left + WIDTH / PIXELS_PER_METRE))

    def _draw_goal(self, terrain: Terrain) -> None:
        pole = np.array([[terrain.goal_x, GROUND_HEIGHT], [terrain.goal_x, GROUND_HEIGHT + 3.2]])
        flag = pole[1] + np.array([[0.0, 0.0], [1.0, -0.35], [0.0, -0.7]])
        self._line(pole, OUTLINE, 3)
        self._fill(flag, GOAL, OUTLINE)

    def _draw_terrain(self, terrain: Terrain) -> None:
        solids = terrain.solids[self._visible(terrain.solids[..., 0].min(1), terrain.solids[..., 0].max(1))]
        for corners in solids:
            pygame.draw.polygon(self._canvas, SOIL, self._pixels(self._cropped(corners)).tolist())
        surface = terrain.surface[self._visible(terrain.surface[:, 0], terrain.surface[:, 2])]
        for ends in surface.reshape(-1, 2, 2):
            self._line(self._cropped(ends), SOIL_EDGE, 2)
        for mark in range(int(self._left) // 5 * 5, int(self._left) + 20, 5):
            place = self._pixels(np.array([float(mark), GROUND_HEIGHT - 0.25]))
            text = self._font.render(f"{mark} m", True, MARK)
            self._canvas.blit(text, text.get_rect(midtop=place.tolist()))

    def _draw_lidars(self, scene: Scene) -> None:
        origin = scene.poses[self._body.head, :2]
        for end in scene.lidars:
            self._line(np.stack([origin, end]), LIDAR, 1)
            pygame.draw.circle(self._canvas, LIDAR, self._pixels(end).tolist(), 2.5 * SUPERSAMPLING)

    def _draw_body(self, scene: Scene) -> None:
        """Draws the parts from the last, which is farthest away, to the head."""
        order = sorted(range(len(scene.poses)), key=lambda part: (part == self._body.head, -part))
        for joint in self._body.joints:
            if joint.outside_parts:  # a neck
                first, second = (self._body.part_index(name) for name in (joint.part_a, joint.part_b))
                end = _placed(scene.poses[second], np.array(self._body.parts[second].local(joint.anchors[1])))
                self._line(np.stack([scene.poses[first, :2], end]), OUTLINE, 5)
        for part in order:
            colour = HEAD if part == self._body.head else (FAR_LIMB if self._far[part] else LIMB)
            self._fill(_placed(scene.poses[part], self._body.parts[part].shape.points), colour, OUTLINE)

    def _draw_progress(self, scene: Scene) -> None:
        """Draws how far the head is between spawn point and goal, along the top."""
        start, goal = scene.terrain.spawn[0], scene.terrain.goal_x
        share = float(np.clip((scene.poses[self._body.head, 0] - start) / (goal - start), 0, 1))
        left, right, y = (SUPERSAMPLING * value for value in (20, WIDTH - 20, 16))
        at = left + share * (right - left)
        pygame.draw.line(self._canvas, TRACK, (left, y), (right, y), 2 * SUPERSAMPLING)
        pygame.draw.line(self._canvas, HEAD, (left, y), (at, y), 4 * SUPERSAMPLING)
        pygame.draw.circle(self._canvas, HEAD, (at, y), 5 * SUPERSAMPLING)
        pygame.draw.circle(self._canvas, GOAL, (right, y), 4 * SUPERSAMPLING)

    def _line(self, ends: Floats, colour: Colour, width: int) -> None:
        start, end = self._pixels(ends).tolist()
        pygame.draw.line(self._canvas, colour, start, end, width * SUPERSAMPLING)

    def _fill(self, points: Floats, colour: Colour, outline: Colour) -> None:
        corners = self._pixels(points).tolist()
        pygame.draw.polygon(self._canvas, colour, corners)
        pygame.draw.polygon(self._canvas, outline, corners, 2 * SUPERSAMPLING)

    def _cropped(self, points: Floats) -> Floats:
        """Returns `points` moved to the frame's edges and a little beyond: pygame's coordinates are small."""
        low = np.array([self._left - 1, self._bottom - 1])
        return np.clip(points, low, low + 2 + np.array([WIDTH, HEIGHT]) / PIXELS_PER_METRE)


def _placed(pose: Floats, points: Floats) -> Floats:
    """Returns `points` (..., 2) of a frame at `pose` (x, y, angle) in world axes."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]]))


def _hidden(part: Part, nearer: tuple[Part, ...]) -> bool:
    """Tells whether one of the `nearer` parts is drawn like `part` and in the same place."""
    return any(other.position == part.position and other.shape == part.shape for other in nearer)


def _gradient(size: tuple[int, int], top: Colour, bottom: Colour) -> pygame.Surface:
    strip = pygame.Surface((1, 2))
    strip.set_at((0, 0), top)
    strip.set_at((0, 1), bottom)
    return pygame.transform.smoothscale(strip, size)
