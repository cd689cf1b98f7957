"""Drawing of a body in its world, with pygame."""

from typing import NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.envs.scene import RenderOptions, Scene
from tma_ray.terrain import GROUND_HEIGHT, Terrain

Colour = tuple[int, int, int]

SKY_TOP, SKY_BOTTOM = (150, 190, 225), (236, 243, 247)
SOIL, SOIL_EDGE, MARK = (104, 122, 92), (66, 84, 60), (142, 158, 130)
ROCK, ROCK_EDGE = (124, 118, 110), (78, 74, 70)
CREEPER, CREEPER_EDGE = (96, 158, 84), (52, 100, 50)
WATER, WATER_EDGE = (70, 150, 205), (44, 112, 172)

COLOURS = HEAD, LIMB, FAR_LIMB, OUTLINE = (86, 98, 178), (126, 138, 212), (104, 110, 150), (42, 48, 96)
DEAD_HEAD = (128,) * 3
DEAD_COLOURS = DEAD_HEAD, (166,) * 3, (142,) * 3, (70,) * 3

GRIP_FREE, GRIP_TOUCHING, GRIP_HOLDING = (246, 208, 52), (242, 138, 40), (210, 40, 36)

LIDAR, LIDAR_WATER, LIDAR_CREEPER = (214, 74, 62), (28, 92, 190), (34, 120, 44)
GOAL, TRACK = (216, 66, 50), (120, 140, 158)


WIDTH, HEIGHT = 600, 400  # size of a frame, in pixels
PIXELS_PER_METRE = 48  # scale of the closest view, and of every view under an open sky
HEAD_SHARE = 0.3  # x of the head as a share of the width, left of the middle since the lidars point ahead

# shares of the frame's height
GROUND_SHARE = 0.22  # height of the ground under an open sky
PASSAGE_SHARE = 0.8  # height of a low passage
SOLID_SHARE = 0.12  # largest height of the ground, and of the ceiling, in a high passage
HEAD_MARGIN = 0.15  # smallest distance of the head from the upper and lower edge

HIGHEST_VIEW = 12.0  # largest height of a view, in m
REACH = 5.0  # distance in m over which ground and ceiling are averaged, for a steady camera


class Viewport(NamedTuple):
    """Section of the world that is visible in a frame."""

    left: float  # x of the left edge, in m
    bottom: float  # y of the lower edge, in m
    scale: float  # pixels of a frame per m

    @property
    def right(self) -> float:
        """Right edge (x), in m."""
        return self.left + WIDTH / self.scale

    @property
    def top(self) -> float:
        """Upper edge (y), in m."""
        return self.bottom + HEIGHT / self.scale


def view_of(head: NDArray[np.float64], terrain: Terrain) -> Viewport:
    """Return the viewport for a body whose head is at `head` (2,).

    Under an open sky the scale is fixed, and the camera rises only with a head that would leave the frame.
    Under a ceiling it follows the head, and shows the whole height of a low passage.
    """
    x, y = float(head[0]), float(head[1])
    if not len(terrain.ceiling):
        height = HEIGHT / PIXELS_PER_METRE
        left = x - HEAD_SHARE * WIDTH / PIXELS_PER_METRE
        bottom = max(GROUND_HEIGHT - GROUND_SHARE * height, y - 0.8 * height)
        return Viewport(left, bottom, PIXELS_PER_METRE)
    floor, roof = _around(terrain.surface, x), _around(terrain.ceiling, x)
    height = float(np.clip((roof - floor) / PASSAGE_SHARE, HEIGHT / PIXELS_PER_METRE, HIGHEST_VIEW))
    lowest, highest = floor + (0.5 - SOLID_SHARE) * height, roof - (0.5 - SOLID_SHARE) * height
    middle = (floor + roof) / 2 if lowest > highest else float(np.clip(y, lowest, highest))
    off = (0.5 - HEAD_MARGIN) * height
    middle = float(np.clip(middle, y - off, y + off))
    scale = HEIGHT / height
    return Viewport(x - HEAD_SHARE * WIDTH / scale, middle - height / 2, scale)


def height_at(segments: NDArray[np.float64], x: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Return the height in m at `x` of the ground or ceiling given by `segments` (m, 4) of a Terrain."""
    ends = np.append(segments[:, 0], segments[-1, 2]), np.append(segments[:, 1], segments[-1, 3])
    return np.asarray(np.interp(x, *ends))


def _around(segments: NDArray[np.float64], x: float) -> float:
    """Return the mean height of `segments` around `x`, weighted by proximity."""
    offsets = np.linspace(-1, 1, 41)
    weights = 1 + np.cos(np.pi * offsets)
    return float(np.average(height_at(segments, x + REACH * offsets), weights=weights))


SUPERSAMPLING = 2
CROP = 10.0  # distance from the frame to which points outside it are clipped, in m: pygame limits coordinates

Floats = NDArray[np.float64]


class Canvas:
    """Canvas for shapes and text in world coordinates, with line widths in pixels of a frame."""

    def __init__(self) -> None:
        self.surface = pygame.Surface((WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING))
        self._glass = pygame.Surface(self.surface.get_size())
        strip = pygame.Surface((1, 2))
        strip.set_at((0, 0), SKY_TOP)
        strip.set_at((0, 1), SKY_BOTTOM)
        self._sky = pygame.transform.smoothscale(strip, self.surface.get_size())
        pygame.font.init()
        self._font = pygame.font.Font(None, 18 * SUPERSAMPLING)

    def start(self, view: Viewport) -> None:
        """Begin a new frame, which shows only the sky."""
        self.view = view
        self.surface.blit(self._sky, (0, 0))

    def frame(self) -> pygame.Surface:
        """Return the frame, scaled down smoothly."""
        return pygame.transform.smoothscale(self.surface, (WIDTH, HEIGHT))

    def pixels(self, smooth: bool = True) -> NDArray[np.uint8]:
        """Return the frame (height, width, 3), or the supersampled surface if not `smooth`."""
        frame = self.frame() if smooth else self.surface
        width, height = frame.get_size()
        content = bytearray(pygame.image.tobytes(frame, "RGB"))  # several times as fast as pygame.surfarray
        return np.frombuffer(content, np.uint8).reshape(height, width, 3)

    def line(self, ends: Floats, colour: Colour, width: int) -> None:
        """Draw a line between two points (2, 2)."""
        start, end = self._pixels(self._cropped(ends)).tolist()
        pygame.draw.line(self.surface, colour, start, end, width * SUPERSAMPLING)

    def fill(self, points: Floats, colour: Colour, outline: Colour | None = None) -> None:
        """Draw a filled polygon with the corners `points` (n, 2), and optionally its `outline`."""
        corners = self._pixels(self._cropped(points)).tolist()
        pygame.draw.polygon(self.surface, colour, corners)
        if outline is not None:
            pygame.draw.polygon(self.surface, outline, corners, 2 * SUPERSAMPLING)

    def dot(self, point: Floats, colour: Colour, radius: float) -> None:
        """Draw a filled circle with a radius in pixels of a frame."""
        centre = self._pixels(self._cropped(point)).tolist()
        pygame.draw.circle(self.surface, colour, centre, radius * SUPERSAMPLING)

    def tint(self, top: float, colour: Colour, opacity: int) -> None:
        """Tint everything below the height `top`, in m, with `colour`, at an opacity from 0 to 255."""
        height = HEIGHT * SUPERSAMPLING
        row = int(np.clip((self.view.top - top) * self.view.scale * SUPERSAMPLING, 0, height))
        self._glass.fill(colour)
        self._glass.set_alpha(opacity)
        self.surface.blit(self._glass, (0, row), (0, 0, WIDTH * SUPERSAMPLING, height - row))

    def text(self, point: Floats, text: str, colour: Colour) -> None:
        """Write text, centred below a point (2,)."""
        drawn = self._font.render(text, True, colour)
        self.surface.blit(drawn, drawn.get_rect(midtop=self._pixels(point).tolist()))

    def bar(self, share: float, colours: tuple[Colour, Colour, Colour]) -> None:
        """Draw a progress bar along the top of the frame, filled to `share` in [0, 1].

        The `colours` are those of the track, the filled part and the end.
        """
        left, right, y = (SUPERSAMPLING * value for value in (20, WIDTH - 20, 16))
        x, (track, done, end) = left + share * (right - left), colours
        pygame.draw.line(self.surface, track, (left, y), (right, y), 2 * SUPERSAMPLING)
        pygame.draw.line(self.surface, done, (left, y), (x, y), 4 * SUPERSAMPLING)
        pygame.draw.circle(self.surface, done, (x, y), 5 * SUPERSAMPLING)
        pygame.draw.circle(self.surface, end, (right, y), 4 * SUPERSAMPLING)

    def sees(self, left: Floats, right: Floats) -> NDArray[np.bool_]:
        """Return a mask (n,) of the objects in the frame, given x at their `left` and `right` ends (n,)."""
        return np.asarray((right >= self.view.left) & (left <= self.view.right))

    def _pixels(self, points: Floats) -> Floats:
        """Convert `points` (..., 2) from world coordinates to pixels of the surface."""
        scale = self.view.scale * SUPERSAMPLING
        x = (points[..., 0] - self.view.left) * scale
        y = HEIGHT * SUPERSAMPLING - (points[..., 1] - self.view.bottom) * scale
        return np.stack([x, y], axis=-1)

    def _cropped(self, points: Floats) -> Floats:
        low = np.array([self.view.left - CROP, self.view.bottom - CROP])
        return np.clip(points, low, np.array([self.view.right + CROP, self.view.top + CROP]))


SMALLEST_GRIP = 4.0  # smallest radius at which a grip sensor is drawn, in pixels
FLAGPOLE = 3.2  # height of the goal's flag, in m
MARK_SPACING = 5  # distance between marks on the ground, in m


class Renderer:
    """Renderer of frames that show one body.

    Args:
        body: body to draw.
        window: True to show frames in a window, in real time.
        frames_per_second: frame rate of the window.
    """

    def __init__(self, body: Embodiment, window: bool, frames_per_second: int) -> None:
        self._body = body
        # True for parts behind others of the same shape and position
        self._far = [
            any(other.position == part.position and other.shape == part.shape for other in body.parts[:index])
            for index, part in enumerate(body.parts)
        ]
        self._canvas = Canvas()
        self._window: pygame.Surface | None = None
        self._frames_per_second, self._clock = frames_per_second, pygame.time.Clock()
        if window:
            pygame.display.init()
            pygame.display.set_caption("tma_ray")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))

    def draw(self, scene: Scene, options: RenderOptions) -> NDArray[np.uint8] | None:
        """Draw `scene`, and return the frame (400, 600, 3), or None if it is shown in the window."""
        head, canvas, terrain = scene.poses[self._body.head, :2], self._canvas, scene.terrain
        canvas.start(view_of(head, terrain))
        foot = np.array([terrain.goal_x, _base(terrain, terrain.goal_x)])
        top = foot + np.array([0.0, FLAGPOLE])
        canvas.line(np.stack([foot, top]), OUTLINE, 3)
        canvas.fill(top + np.array([[0.0, 0.0], [1.0, -0.35], [0.0, -0.7]]), GOAL, OUTLINE)
        self._draw_world(scene)
        if options.lidars:
            for end, hit in zip(scene.lidars, scene.hits, strict=True):
                colour = LIDAR_CREEPER if hit > 0 else LIDAR_WATER if hit < 0 else LIDAR
                canvas.line(np.stack([head, end]), colour, 1)
                canvas.dot(end, colour, 2.5)
        self._draw_body(scene)
        canvas.tint(terrain.water_y, WATER, 60)
        start = terrain.spawn[0]
        canvas.bar(float(np.clip((head[0] - start) / (terrain.goal_x - start), 0, 1)), (TRACK, HEAD, GOAL))
        if self._window is None:
            return canvas.pixels(options.smooth)
        self._window.blit(canvas.frame(), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._frames_per_second)
        return None

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None

    def _draw_world(self, scene: Scene) -> None:
        """Draw water, creepers, ground, ceiling, and marks that show the distance from the start."""
        canvas, view, terrain = self._canvas, self._canvas.view, scene.terrain
        canvas.tint(terrain.water_y, WATER, 120)
        edge = np.array([[view.left, terrain.water_y], [view.right, terrain.water_y]])
        if view.bottom < terrain.water_y < view.top:
            canvas.line(edge, WATER_EDGE, 1)
        # creepers, before the ceiling, which covers their upper ends
        sizes = terrain.creepers[:, 2:] - terrain.creepers[:, :2]
        reach = np.hypot(*sizes.T) / 2
        seen = canvas.sees(scene.creepers[:, 0] - reach, scene.creepers[:, 0] + reach)
        for (x, y, cosine, sine), size in zip(scene.creepers[seen], sizes[seen], strict=True):
            corners = size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            turned = corners @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])
            canvas.fill(turned, CREEPER, CREEPER_EDGE)
        split = terrain.ground_solids
        for solids, surface, colour, edge_colour in (
            (terrain.solids[:split], terrain.surface, SOIL, SOIL_EDGE),
            (terrain.solids[split:], terrain.ceiling, ROCK, ROCK_EDGE),
        ):
            for corners in solids[canvas.sees(solids[..., 0].min(1), solids[..., 0].max(1))]:
                canvas.fill(corners, colour)
            for ends in surface[canvas.sees(surface[:, 0], surface[:, 2])].reshape(-1, 2, 2):
                canvas.line(ends, edge_colour, 2)
        first = int(view.left) // MARK_SPACING * MARK_SPACING
        for mark in range(first, int(view.right) + 1 + MARK_SPACING, MARK_SPACING):
            position = np.array([float(mark), _base(terrain, mark) - 0.25])
            if position[1] > view.bottom:
                canvas.text(position, f"{mark} m", MARK)

    def _draw_body(self, scene: Scene) -> None:
        """Draw the parts from the farthest (the last) to the head, in grey if the body is dead."""
        canvas, body, poses = self._canvas, self._body, scene.poses
        head, limb, far_limb, outline = DEAD_COLOURS if scene.dead else COLOURS
        for joint in body.joints:
            if joint.outside_parts:  # a line in place of a neck
                first, second = (body.part_index(name) for name in (joint.part_a, joint.part_b))
                end = _placed(poses[second], np.array(body.parts[second].local(joint.anchors[1])))
                canvas.line(np.stack([poses[first, :2], end]), outline, 5)
        for part in sorted(range(len(poses)), key=lambda part: (part == body.head, -part)):
            colour = head if part == body.head else (far_limb if self._far[part] else limb)
            canvas.fill(_placed(poses[part], body.parts[part].shape.points), colour, outline)
        for sensor, (touches, holds) in zip(body.grip_sensors, scene.grips, strict=True):
            part = body.part_index(sensor.part)
            centre = _placed(poses[part], np.array(body.parts[part].local(sensor.position)))
            radius = max(SMALLEST_GRIP, sensor.radius * canvas.view.scale)
            colour = GRIP_TOUCHING if touches else GRIP_FREE
            canvas.dot(centre, outline, radius + 1)
            canvas.dot(centre, GRIP_HOLDING if holds else colour, radius)


def _placed(pose: Floats, points: Floats) -> Floats:
    """Transform `points` (..., 2) from a coordinate frame at `pose` (x, y, angle) to world coordinates."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]]))


def _base(terrain: Terrain, x: float) -> float:
    """Return the height in m of the ground at `x`, ignoring stumps."""
    return float(height_at(terrain.surface, x)) if len(terrain.ceiling) else GROUND_HEIGHT
