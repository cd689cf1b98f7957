"""Measurements of bodies by the protocols that were used for the original release.

``python tests/physics/behaviour.py`` prints the tables of docs/fidelity.md.
"""

import csv
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from parkour_worlds import parkour_rules

from tma_ray.embodiments import BodyType, Embodiment, embodiment_names, load_embodiment
from tma_ray.envs.base import PUSH
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import Engine, make_engine
from tma_ray.physics.rules import BodyArrays, body_arrays
from tma_ray.terrain import GROUND_HEIGHT, Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

BEHAVIOUR = Path(__file__).parents[1] / "reference" / "behaviour.csv"


class Statistics(NamedTuple):
    """Statistics of a quantity over `n` repetitions; `std` is the population's."""

    n: int
    mean: float
    std: float


def measured(protocol: str, environment: str, embodiment: str, case: str = "") -> dict[str, Statistics]:
    """Return the release's statistics of one body under one protocol, by quantity."""
    return _behaviour()[protocol, environment, embodiment, case]


@cache
def _behaviour() -> dict[tuple[str, ...], dict[str, Statistics]]:
    table: dict[tuple[str, ...], dict[str, Statistics]] = {}
    with BEHAVIOUR.open(newline="") as file:
        for row in csv.DictReader(file):
            key = row["protocol"], row["environment"], row["embodiment"], row["case"]
            statistics = Statistics(int(row["n"]), float(row["mean"]), float(row["std"]))
            table.setdefault(key, {})[row["figure"]] = statistics
    return table


Floats = NDArray[np.float64]


def world_points(pose: Floats, points: Floats) -> Floats:
    """Return `points` (n, 2) in world coordinates, given the `pose` (x, y, angle, ...) of their frame."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]])


def joint_drift(state: Floats, body: BodyArrays) -> Floats:
    """Return the distances (j,) between the two anchors of joints, in m."""
    pairs = zip(body.joint_parts, body.anchors, strict=True)
    apart = [world_points(state[a], pair[:1]) - world_points(state[b], pair[1:]) for (a, b), pair in pairs]
    return np.array([np.linalg.norm(each) for each in apart])


def limit_overshoot(state: Floats, body: BodyArrays) -> Floats:
    """Return the angles (j,) of joints beyond their limits, in rad; 0 within."""
    a, b = body.joint_parts.T
    angles = state[b, 2] - state[a, 2]
    return np.maximum(0, np.maximum(body.limits[:, 0] - angles, angles - body.limits[:, 1]))


def penetration(state: Floats, body: BodyArrays, terrain: Terrain) -> Floats:
    """Return the penetration depths (p,) of parts into the terrain's boxes, in m; 0 outside.

    Depth is the shortest way out to the top or a side.
    """
    left, right, top = terrain.solids[:, 0, 0], terrain.solids[:, 1, 0], terrain.solids[:, 2, 1]
    depths = np.zeros(len(state))
    for part, pose in enumerate(state):
        corners = body.vertices[body.first_vertex[part] : body.first_vertex[part + 1]]
        x, y = world_points(pose, corners).T[:, :, None]
        depths[part] = max(0.0, np.minimum(top - y, np.minimum(x - left, right - x)).max())
    return depths


TASKS = ((0.0, 6.0), (1.5, 3.0), (3.0, 1.0))
CLASSIC = "classic_bipedal"

WALKERS = [name for name in embodiment_names() if load_embodiment(name).body_type is BodyType.WALKER]
"""Bodies that were measured in the release's Stump Tracks."""

Figures = dict[str, Floats]
Place = tuple[float, float] | Terrain
"""A task of Stump Tracks, or a world of Parkour."""


def embodied(name: str, place: Place = TASKS[0]) -> tuple[Embodiment, Engine]:
    """Return a body by name, and its engine under the rules of `place`."""
    body = load_embodiment(name)
    return body, make_engine(body, parkour_rules(body) if isinstance(place, Terrain) else RULES)


def start(engine: Engine, place: Place, rng: np.random.Generator) -> Terrain:
    """Reset an engine as the environment does, and return the world."""
    if not isinstance(place, Terrain):
        place = stump_tracks(np.array(place, dtype=np.float32), rng)
    engine.reset(place, rng.uniform(-PUSH, PUSH))
    return place


def zero_action(name: str = CLASSIC, count: int = 20, place: Place = TASKS[0]) -> Figures:
    """Measure 100 steps without torque, continued after termination."""
    body, engine, rows = *embodied(name, place), []
    for seed in range(count):
        start(engine, place, np.random.default_rng(seed))
        begin = engine.state[body.head, 0]
        ended = [step for step in range(1, 101) if engine.step(np.zeros(body.action_size))[2]]
        x, y, angle = engine.state[body.head, :3]
        rows.append((y - GROUND_HEIGHT, angle, x - begin, ended[0] if ended else 101))
    names = ("head_height_above_ground", "head_angle", "head_x_displacement", "first_terminal_step")
    return dict(zip(names, np.array(rows).T, strict=True))


def episodes(place: Place, count: int, cap: int = 2000, name: str = CLASSIC) -> Figures:
    """Measure `count` episodes of uniform random actions."""
    body, engine, rows = *embodied(name, place), []
    for seed in range(count):
        rng = np.random.default_rng([seed, 1])
        start(engine, place, rng)
        begin, total, ended, length = engine.state[body.head, 0], 0.0, False, 0
        while not ended and length < cap:
            _, reward, ended = engine.step(rng.uniform(-1, 1, body.action_size))
            total, length = total + reward, length + 1
        rows.append((ended, length, total, engine.state[body.head, 0] - begin))
    fell, length, total, moved = np.array(rows).T
    return {
        "fraction_terminated": fell,
        "length": length,
        "length_when_fallen": length[fell > 0],
        "episode_return": total,
        "x_displacement": moved,
    }


def gaits(name: str = CLASSIC, count: int = 100, place: Place = TASKS[0]) -> Figures:
    """Measure distance and speed of random sinusoidal gaits in 200 steps or until termination."""
    body, engine, distances, speeds, lengths = *embodied(name, place), [], [], []
    for seed in range(count):
        rng = np.random.default_rng([seed, 2])
        start(engine, place, rng)
        frequency, low = rng.uniform(0.5, 3), (0.3, 0.0, -0.5)
        high, motors = (1, 2 * np.pi, 0.5), body.action_size
        size, phase, bias = (rng.uniform(a, b, motors) for a, b in zip(low, high, strict=True))
        xs = [engine.state[body.head, 0]]
        for step in range(200):
            angle = 2 * np.pi * frequency * step / 50 + phase
            ended = engine.step(np.clip(size * np.sin(angle) + bias, -1, 1))[2]
            xs.append(engine.state[body.head, 0])
            if ended:
                break
        track = np.array(xs)
        distances.append(track[-1] - track[0])
        lengths.append(len(track) - 1)
        if len(track) > 50:
            speeds.append(np.max(track[50:] - track[:-50]))
    figures = {"distance_200_steps": distances, "best_1s_speed": speeds, "length": lengths}
    return {name: np.array(values) for name, values in figures.items()}


def full_torque(steps: int, seed: int = 0, task: tuple[float, float] = (1.5, 1.0)) -> Iterator[Figures]:
    """Yield simulation errors after every step of random full torques, with a new world every 500 steps."""
    embodiment, engine = embodied(CLASSIC)
    rng, body = np.random.default_rng([seed, 3]), body_arrays(embodiment)
    for step in range(steps):
        if step % 500 == 0:
            terrain = start(engine, task, rng)
        engine.step(rng.choice([-1.0, 1.0], 4))
        yield {
            "state": engine.state.copy(),
            "joint_drift": joint_drift(engine.state, body),
            "limit_overshoot": limit_overshoot(engine.state, body),
            "penetration": penetration(engine.state, body, terrain),
        }


def release_of_task(task: tuple[float, float]) -> dict[str, Statistics]:
    """Return the release's statistics of the classic body's random actions on a task, by quantity."""
    case = f"stump_height={task[0]:g} obstacle_spacing={task[1]:g}"
    return measured("random_actions_2000", "stump_tracks", CLASSIC, case)


def table_of_bodies() -> Iterator[str]:
    """Yield rows of a Markdown table of the release's means against ours, by protocol and body."""
    protocols = {
        "zero_actions": zero_action,
        "random_actions": lambda name: episodes(TASKS[0], 200, 500, name),
        "random_gaits": gaits,
    }
    for protocol, measure in protocols.items():
        for name in WALKERS:
            release = measured(protocol, "stump_tracks", name)
            yield f"| {protocol} | {name} | {cells(release, measure(name))} |"


def cells(release: dict[str, Statistics], ours: Figures) -> str:
    """Return cells of a Markdown table: means of the release / ours, for common quantities."""
    pairs = [(release[figure], values) for figure, values in ours.items() if figure in release]
    return " | ".join(f"{theirs.mean:.2f} / {values.mean():.2f}" for theirs, values in pairs)


def table() -> Iterator[str]:
    """Yield rows of a Markdown table: the release against ours, then our simulation errors."""
    protocols = {
        "zero_actions": (zero_action(), measured("zero_actions", "stump_tracks", CLASSIC)),
        "random_gaits": (gaits(), measured("random_gaits", "stump_tracks", CLASSIC)),
    }
    protocols |= {f"random_actions {task}": (episodes(task, 200), release_of_task(task)) for task in TASKS}
    for protocol, (ours, release) in protocols.items():
        for name, values in ours.items():
            theirs = f"{release[name].mean:.2f} ± {release[name].std:.2f}"
            yield f"| {protocol} | {name} | {theirs} | {values.mean():.2f} ± {values.std():.2f} |"
    errors = list(full_torque(10_000))
    for name in ("joint_drift", "limit_overshoot", "penetration"):
        worst = np.array([error[name].max() for error in errors])
        yield f"| {name} | {np.percentile(worst, 99):.4f} | {worst.max():.4f} |"


if __name__ == "__main__":
    sys.stdout.writelines(f"{row}\n" for row in (*table(), *table_of_bodies()))
