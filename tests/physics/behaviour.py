"""The classic bipedal walker under the protocols by which the original release was measured.

``TMA_REFERENCE=folder python tests/physics/behaviour.py`` prints the table of docs/fidelity.md.
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

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import LIDAR_ANGLES, PUSH
from tma_ray.physics import Engine, make_engine
from tma_ray.physics.arrays import body_arrays
from tma_ray.terrain import GROUND_HEIGHT, Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

TASKS = ((0.0, 6.0), (1.5, 3.0), (3.0, 1.0))
BODY = load_embodiment("classic_bipedal")

Figures = dict[str, Floats]


def start(engine: Engine, task: tuple[float, float], rng: np.random.Generator) -> Terrain:
    """Resets `engine` as the environment does and returns the new world."""
    terrain = stump_tracks(np.array(task, dtype=np.float32), rng)
    engine.reset(terrain, rng.uniform(-PUSH, PUSH))
    return terrain


def zero_action(count: int = 20) -> Figures:
    """Returns what 100 steps without torque lead to, going on after termination."""
    engine, rows = make_engine(BODY, LIDAR_ANGLES), []
    for seed in range(count):
        start(engine, TASKS[0], np.random.default_rng(seed))
        begin = engine.state[0, 0]
        ended = [step for step in range(1, 101) if engine.step(np.zeros(4))[2]]
        x, y, angle = engine.state[0, :3]
        rows.append((y - GROUND_HEIGHT, angle, x - begin, ended[0] if ended else 101))
    names = ("head_height_above_ground", "head_angle", "head_x_displacement", "first_terminal_step")
    return dict(zip(names, np.array(rows).T, strict=True))


def episodes(task: tuple[float, float], count: int, cap: int = 2000) -> Figures:
    """Returns figures of `count` episodes of uniform actions."""
    engine, rows = make_engine(BODY, LIDAR_ANGLES), []
    for seed in range(count):
        rng = np.random.default_rng([seed, 1])
        start(engine, task, rng)
        begin, total, ended, length = engine.state[0, 0], 0.0, False, 0
        while not ended and length < cap:
            _, reward, ended = engine.step(rng.uniform(-1, 1, 4))
            total, length = total + reward, length + 1
        rows.append((ended, length, total, engine.state[0, 0] - begin))
    fell, length, total, moved = np.array(rows).T
    return {
        "fraction_ending_in_a_fall": fell,
        "length": length,
        "length_when_fallen": length[fell > 0],
        "episode_return": total,
        "x_displacement": moved,
    }


def gaits(count: int = 100) -> Figures:
    """Returns how far and fast random sinusoidal gaits go in 200 steps or until termination."""
    engine, distances, speeds, lengths = make_engine(BODY, LIDAR_ANGLES), [], [], []
    for seed in range(count):
        rng = np.random.default_rng([seed, 2])
        start(engine, TASKS[0], rng)
        frequency, low = rng.uniform(0.5, 3), (0.3, 0.0, -0.5)
        size, phase, bias = (rng.uniform(a, b, 4) for a, b in zip(low, (1, 2 * np.pi, 0.5), strict=True))
        xs = [engine.state[0, 0]]
        for step in range(200):
            angle = 2 * np.pi * frequency * step / 50 + phase
            ended = engine.step(np.clip(size * np.sin(angle) + bias, -1, 1))[2]
            xs.append(engine.state[0, 0])
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
    rng, engine, body = np.random.default_rng([seed, 3]), make_engine(BODY, LIDAR_ANGLES), body_arrays(BODY)
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
    sys.stdout.writelines(f"{row}\n" for row in table(reference(Path(os.environ["TMA_REFERENCE"]))))
