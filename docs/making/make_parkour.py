"""Draw twelve worlds of Parkour with suitable bodies, and the animation of the README.

python docs/making/make_parkour.py --output docs/images
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from tma_ray.embodiments import Embodiment, load_embodiment
from tma_ray.envs.drawing import Renderer, height_at
from tma_ray.envs.scene import RenderOptions, scene_of
from tma_ray.physics import Engine, Rules, make_engine
from tma_ray.physics.kernels import NOTHING
from tma_ray.terrain import Terrain
from tma_ray.terrain.parkour import CPPN, DEFAULT_WEIGHTS, GROUND_LIMIT, outlines, parkour
from tma_ray.terrain.terrain import TERRAIN_STEP
from tma_ray.viewing.rendering import write_frames

COLUMNS = 3
CELL, GAP, CAPTION, MAP = (3.7, 3.75), 0.15, 0.6, 0.55
"""Width and height of a cell, space between cells, heights of caption and map, in inches."""

DPI = 110

LEVEL = 2.0, 0.4
"""Distance around a level place, and largest difference of heights within it, in m."""

SOIL, ROCK, WATER, SKY, HERE = "#687a5c", "#7c766e", "#7fb4dc", "#dfeaf4", "#d84232"
SERVO, DAMPING = 6.0, 0.3
"""Gains of the controller that keeps a pose, per rad and per rad/s."""

BEAT = 12
"""Steps between two decisions of a random policy."""

STROKE = 16
"""Period of a swimmer's strokes, in steps."""

GRASP_STEPS = 600
"""Largest number of steps until a random climber grasps a creeper."""

Action = NDArray[np.float64]
Acting = Callable[[int, Engine], Action]


@dataclass(frozen=True)
class View:
    """Cell of the picture: a body in a world of Parkour.

    Attributes:
        body: name of the body.
        theta: input of the CPPN.
        delta: divisor of heights.
        x: approximate position of the body, in m; it starts where ground or ceiling is level.
        water: height of the water over the ground there, in m; None for dry ground.
        creepers: mean height and spacing of creepers, in m.
        swinging: True if creepers swing.
        grasp: True to show the body once its hands first hold different things.
        lift: height over the ground at which the body starts, in m.
        steps: number of steps of the body.
        seed: seed of random actions.
    """

    body: str
    theta: tuple[float, float, float]
    delta: float = 10.0
    x: float = 12.0
    water: float | None = None
    creepers: tuple[float, float] = (2.0, 3.0)
    swinging: bool = False
    grasp: bool = False
    lift: float = 0.0
    steps: int = 12
    seed: int = 0


CLIMBER = View("climbing_chimpanzee", (-0.1, 0.85, 0.3), 15, 42.0, None, (3.0, 1.0), True, steps=123, seed=3)
SWIMMER = View("fish", (0.05, 0.75, -0.1), 20, 36.0, 5.0, (2.5, 2.0), lift=1.0, steps=123)
"""Second body of the README's animation, beside `CLIMBER`."""

SHEET = (
    View("classic_bipedal", (-0.1, 0.7, 0.0), x=31.0),
    View("spider", (-0.3, 0.9, 0.25), delta=25, x=40.0, creepers=(0.8, 2.0)),
    View("quadrupedal", (0.0, 0.8, 0.2), delta=20, x=52.0, creepers=(1.5, 4.0)),
    View("millipede", (-0.2, 0.65, 0.1), delta=35, x=26.0, creepers=(0.5, 1.0), steps=40),
    View("fish", (-0.15, 0.95, 0.1), x=36.0, water=9.0, lift=3.0, steps=40),
    View("fish", (0.05, 0.75, -0.1), delta=20, x=45.0, water=2.2, lift=0.2, steps=60, creepers=(2.5, 2.0)),
    View("amphibious_bipedal", (-0.3, 0.75, 0.3), x=60.0, water=1.5, creepers=(3.0, 5.0)),
    View(
        "amphibious_bipedal", (-0.05, 0.9, 0.05), delta=30, x=34.0, water=5.0, creepers=(1.0, 3.0), steps=60
    ),
    View("climbing_chimpanzee", (-0.25, 1.0, 0.0), x=29.2, creepers=(3.0, 1.0), grasp=True, seed=10),
    View("climbing_chest_chimpanzee", (0.0, 0.6, 0.15), x=48.0, creepers=(1.0, 4.0), steps=30),
    replace(CLIMBER, creepers=(4.0, 1.0), grasp=True, steps=30, seed=0),
    View("wheel", (0.0, 1.0, 0.2), delta=15, x=55.0, creepers=(0.5, 5.0)),
)

STEPS_PER_FRAME = 3
CLIP_SIZE = 360, 240
"""Width and height of each animation, in pixels."""


def world_of(view: View, cppn: CPPN) -> tuple[Terrain, NDArray[np.float32]]:
    """Return the world of a cell, and its task."""
    theta = np.array(view.theta, np.float32)
    ground, ceiling = outlines(theta, view.delta, cppn)
    level = 0.0
    if view.water is not None:
        bottom = GROUND_LIMIT / view.delta
        points = np.arange(len(ground)) * TERRAIN_STEP
        here = np.interp(level_place(np.stack([points, ground], axis=1), view.x), points, ground)
        level = (here + view.water - bottom) / (ceiling.max() - bottom)
    task = np.array([*theta, level, 0.25, *view.creepers, view.delta], np.float32)
    terrain = parkour(task, np.random.default_rng(0), cppn=cppn, swinging_creepers=view.swinging)
    x = level_place(terrain.ceiling if "climbing" in view.body else terrain.surface, view.x)
    spawn = np.array([x, float(height_at(terrain.surface, x)) + view.lift])
    return terrain._replace(spawn=spawn), task


def level_place(segments: NDArray[np.float64], x: float) -> float:
    """Return the x coordinate nearest to `x` at which the ground or ceiling is level, in m."""
    lefts, heights = segments[1:-1, 0], segments[1:-1, 1]
    spread = [np.ptp(heights[np.abs(lefts - left) < LEVEL[0]]) for left in lefts]
    level = lefts[np.array(spread) <= max(LEVEL[1], min(spread))]
    return float(level[np.argmin(np.abs(level - x))])


def keep_pose(engine: Engine) -> Acting:
    """Return a policy that keeps the joint angles, and the grips closed."""
    first, second = engine.arrays.joint_parts.T
    wanted = engine.state[second, 2] - engine.state[first, 2]

    def act(_: int, engine: Engine) -> Action:
        angle, speed = (engine.state[second, field] - engine.state[first, field] for field in (2, 5))
        return np.concatenate([SERVO * (wanted - angle) - DAMPING * speed, np.ones(len(engine.grips))])

    return lambda step, engine: np.clip(act(step, engine), -1, 1)


def wriggle(engine: Engine) -> Acting:
    """Return a policy of a swimmer: oscillating joints with a phase shift between them."""
    phases = 0.9 * np.arange(len(engine.arrays.motors))
    return lambda step, _: np.sin(2 * np.pi * step / STROKE + phases)


def swing(engine: Engine, seed: int = 0) -> Acting:
    """Return a policy with random motor actions that opens a random grip at times."""
    rng, motors = np.random.default_rng(seed), len(engine.arrays.motors)
    drawn = np.ones(motors + len(engine.grips))

    def act(step: int, _: Engine) -> Action:
        if step % BEAT == 0:
            drawn[:motors] = rng.uniform(-1, 1, motors)
            drawn[motors:] = 1.0
            if step // BEAT % 2:
                drawn[motors + rng.integers(len(drawn) - motors)] = -1.0
        return drawn.copy()

    return act


def engine_of(body: Embodiment) -> Engine:
    """Return the physics engine of Parkour for `body`."""
    return make_engine(body, Rules("parkour", body.lidars, observes_medium=True))


def play(view: View, body: Embodiment, terrain: Terrain) -> tuple[Engine, NDArray[np.float32]]:
    """Return the engine after the steps of a cell, and the last observation."""
    engine = engine_of(body)
    observation = engine.reset(terrain, 0.0)
    if view.grasp:
        acting, step = swing(engine, view.seed), 0
        while not _straddles(engine.grips[:, 1]):
            if step == GRASP_STEPS:
                raise SystemExit(f"the {view.body} at x = {view.x} grasps no creeper in {GRASP_STEPS} steps")
            observation, *_ = engine.step(acting(step, engine))
            step += 1
    acting = wriggle(engine) if view.body == "fish" else keep_pose(engine)
    for step in range(view.steps):
        observation, *_ = engine.step(acting(step, engine))
    return engine, observation


def _straddles(held: NDArray[np.int64]) -> bool:
    """Return True if all hands hold something, and not all the same thing."""
    return bool(np.all(held > NOTHING)) and len(set(held.tolist())) > 1


def draw_map(axis: Axes, terrain: Terrain, x: float, y: float) -> None:
    """Draw a map of the whole world with the position of the body."""
    ends = np.linspace(0, terrain.goal_x, 800)
    ground, ceiling = (height_at(segments, ends) for segments in (terrain.surface, terrain.ceiling))
    low, high = ground.min() - 2, ceiling.max() + 2
    axis.set(xlim=(0, terrain.goal_x), ylim=(low, high), xticks=[], yticks=[], facecolor=SKY)
    axis.fill_between(ends, low, np.full_like(ends, np.clip(terrain.water_y, low, high)), color=WATER, lw=0)
    for left, bottom, right, top in terrain.creepers:
        axis.fill_between([left, right], bottom, top, color="#609e54", lw=0)
    axis.fill_between(ends, low, ground, color=SOIL, lw=0)
    axis.fill_between(ends, ceiling, high, color=ROCK, lw=0)
    axis.plot([x], [y], "o", color=HERE, markersize=4)


def caption(view: View, task: NDArray[np.float32]) -> str:
    """Return a caption with the body and the task."""
    theta = ", ".join(f"{value:g}" for value in view.theta)
    water = "dry" if view.water is None else f"water {task[3]:.2f}"
    creepers = f"creepers {view.creepers[0]:g} m every {view.creepers[1]:g} m"
    return (
        f"{view.body.replace('_', ' ')}\n"
        f"θ ({theta}), δ {view.delta:g}, {water}\n{creepers}{', swinging' * view.swinging}"
    )


def sheet(path: Path) -> None:
    """Draw the picture of all cells."""
    rows = -(-len(SHEET) // COLUMNS)
    size = COLUMNS * CELL[0] + GAP, rows * CELL[1]
    figure = plt.figure(figsize=size)
    cppn = CPPN.load(DEFAULT_WEIGHTS)
    for index, view in enumerate(SHEET):
        row, column = divmod(index, COLUMNS)
        left, top, width = GAP + column * CELL[0], size[1] - row * CELL[1] - CAPTION, CELL[0] - GAP
        body = load_embodiment(view.body)
        terrain, task = world_of(view, cppn)
        engine, observation = play(view, body, terrain)
        upper = figure.add_axes(_share((left, top - width * 2 / 3, width, width * 2 / 3), size))
        lower = figure.add_axes(_share((left, top - width * 2 / 3 - MAP, width, MAP), size))
        renderer = Renderer(body, False, 50)
        upper.imshow(renderer.draw(scene_of(engine, terrain, observation), RenderOptions()))
        upper.set_axis_off()
        upper.set_title(caption(view, task), fontsize=8, loc="left")
        draw_map(lower, terrain, *engine.state[body.head, :2])
    figure.savefig(path, dpi=DPI)
    plt.close(figure)


def _share(box: tuple[float, ...], size: tuple[float, float]) -> tuple[float, ...]:
    """Convert left, bottom, width and height from inches to shares of a figure of `size`."""
    return tuple(value / size[index % 2] for index, value in enumerate(box))


def clip(view: View, acting: Callable[[Engine], Acting]) -> list[NDArray[np.uint8]]:
    """Return the frames (height, width, 3) of a body that acts under a policy."""
    body, (terrain, _) = load_embodiment(view.body), world_of(view, CPPN.load(DEFAULT_WEIGHTS))
    engine, frames, renderer = engine_of(body), [], Renderer(body, False, 50)
    observation, act = engine.reset(terrain, 0.0), acting(engine)
    for step in range(view.steps):
        if step % STEPS_PER_FRAME == 0:
            frame = Image.fromarray(renderer.draw(scene_of(engine, terrain, observation), RenderOptions()))
            frames.append(np.asarray(frame.resize(CLIP_SIZE, Image.Resampling.LANCZOS)))
        observation, *_ = engine.step(act(step, engine))
    return frames


def moving(path: Path) -> None:
    """Write the animation of a chimpanzee and a fish side by side."""
    both = zip(clip(CLIMBER, partial(swing, seed=CLIMBER.seed)), clip(SWIMMER, wriggle), strict=True)
    write_frames(path, [np.concatenate(pair, axis=1) for pair in both], Fraction(50, STEPS_PER_FRAME))


def main() -> None:
    """Write parkour.png and parkour.gif."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    sheet(options.output / "parkour.png")
    moving(options.output / "parkour.gif")


if __name__ == "__main__":
    main()
