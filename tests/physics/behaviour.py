"""The bodies under the protocols by which the original release was measured.

``TMA_REFERENCE=folder python tests/physics/behaviour.py`` prints the tables of docs/fidelity.md.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measures import Floats, joint_drift, limit_overshoot, penetration
from parkour_worlds import parkour_rules

from tma_ray.embodiments import BodyType, Embodiment, embodiment_names, load_embodiment
from tma_ray.envs.body_environment import PUSH
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import Engine, make_engine
from tma_ray.physics.arrays import body_arrays
from tma_ray.terrain import GROUND_HEIGHT, Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

TASKS = ((0.0, 6.0), (1.5, 3.0), (3.0, 1.0))
CLASSIC = "classic_bipedal"

RELEASE_NAMES = {
    "short_bipedal": "small_bipedal",
    "quadrupedal": "big_quadru",
    "walking_chimpanzee": "profile_chimpanzee",
    "old_quadrupedal": "old_big_quadru",
    "climbing_chimpanzee": "climbing_profile_chimpanzee",
    "climbing_chest_chimpanzee": "climbing_chest_profile_chimpanzee",
}
"""Names of the release that differ from ours."""

WALKERS = [name for name in embodiment_names() if load_embodiment(name).body_type is BodyType.WALKER]
"""Those of which the release was measured in Stump Tracks."""

Figures = dict[str, Floats]
Place = tuple[float, float] | Terrain
"""A task of Stump Tracks, or a world of Parkour."""


def embodied(name: str, place: Place = TASKS[0]) -> tuple[Embodiment, Engine]:
    """Returns the body called `name` and an engine for it under the rules of `place`."""
    body = load_embodiment(name)
    return body, make_engine(body, parkour_rules(body) if isinstance(place, Terrain) else RULES)


def start(engine: Engine, place: Place, rng: np.random.Generator) -> Terrain:
    """Resets `engine` as the environment does and returns the new world."""
    if not isinstance(place, Terrain):
        place = stump_tracks(np.array(place, dtype=np.float32), rng)
    engine.reset(place, rng.uniform(-PUSH, PUSH))
    return place


def zero_action(name: str = CLASSIC, count: int = 20, place: Place = TASKS[0]) -> Figures:
    """Returns what 100 steps without torque lead to, going on after termination."""
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
    """Returns figures of `count` episodes of uniform actions."""
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
        "fraction_ending_in_a_fall": fell,
        "length": length,
        "length_when_fallen": length[fell > 0],
        "episode_return": total,
        "x_displacement": moved,
    }


def gaits(name: str = CLASSIC, count: int = 100, place: Place = TASKS[0]) -> Figures:
    """Returns how far and fast random sinusoidal gaits go in 200 steps or until termination."""
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
    return {
        "distance_200_steps": np.array(distances),
        "best_1s_speed": np.array(speeds),
        "length": np.array(lengths),
    }


def full_torque(steps: int, seed: int = 0, task: tuple[float, float] = (1.5, 1.0)) -> Iterator[Figures]:
    """Yields the errors of the simulation after each step of random full torques, in worlds of 500 steps."""
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


def reference(folder: Path) -> dict[str, dict[str, Any]]:
    """Returns the release's figures of the same protocols, by protocol and figure."""
    data = json.loads((folder / "behaviour.json").read_text())
    random = data["random_actions_stump_tracks_cap2000"]["results"]
    by_task = {
        f"random actions, task {task}": random[f"classic_bipedal/height={task[0]:g},spacing={task[1]:g}"]
        for task in TASKS
    }
    body = "stump_tracks/classic_bipedal"
    return {
        "zero actions": data["zero_action_flat_ground_100_steps"]["bodies"][body],
        "random gaits": data["random_open_loop_gaits"]["bodies"][body],
        **by_task,
    }


def reference_of(name: str, folder: Path) -> dict[str, dict[str, Any]]:
    """Returns the release's figures of the body that we call `name`, by protocol and figure."""
    data = json.loads((folder / "behaviour.json").read_text())
    key = f"stump_tracks/{RELEASE_NAMES.get(name, name)}"
    random = data["random_actions_cap500"]["bodies"][key]
    return {
        "zero actions": data["zero_action_flat_ground_100_steps"]["bodies"][key],
        "random actions": random | {"fraction_ending_in_a_fall": random["fraction_terminated"]},
        "random gaits": data["random_open_loop_gaits"]["bodies"][key],
    }


def table_of_bodies(folder: Path) -> Iterator[str]:
    """Yields the release's figures against ours, one row of a Markdown table per body and protocol."""
    for name in WALKERS:
        theirs = reference_of(name, folder)
        ours = {
            "zero actions": zero_action(name),
            "random actions": episodes(TASKS[0], 200, 500, name),
            "random gaits": gaits(name),
        }
        for protocol, figures in ours.items():
            pairs = [(theirs[protocol].get(figure), values) for figure, values in figures.items()]
            cells = [f"{release['mean']:.2f} / {values.mean():.2f}" for release, values in pairs if release]
            yield f"| {protocol} | {name} | {' | '.join(cells)} |"


def table(theirs: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yields reference against ours, then the errors of our simulation, as rows of a Markdown table."""
    ours = {"zero actions": zero_action(), "random gaits": gaits()}
    ours |= {f"random actions, task {task}": episodes(task, 200) for task in TASKS}
    for protocol, figures in ours.items():
        for name, values in figures.items():
            release = theirs[protocol][name]
            measured = f"{release['mean']:.2f} ± {release['std']:.2f}"
            yield f"| {protocol} | {name} | {measured} | {values.mean():.2f} ± {values.std():.2f} |"
    errors = list(full_torque(10_000))
    for name in ("joint_drift", "limit_overshoot", "penetration"):
        worst = np.array([error[name].max() for error in errors])
        yield f"| {name} | {np.percentile(worst, 99):.4f} | {worst.max():.4f} |"


if __name__ == "__main__":
    FOLDER = Path(os.environ["TMA_REFERENCE"])
    sys.stdout.writelines(f"{row}\n" for row in (*table(reference(FOLDER)), *sorted(table_of_bodies(FOLDER))))
