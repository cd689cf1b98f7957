"""Recorded episodes of random actions in Python's engine, for replay in the page's engine.

``python episodes.py FOLDER EPISODES STEPS BODY...``
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.embodiments import load_embodiment
from tma_ray.envs import make_environment
from tma_ray.envs.base import PUSH
from tma_ray.playground.contents import PLAYED, body_record, constants, stored
from tma_ray.terrain import Terrain


def world_record(terrain: Terrain) -> dict[str, Any]:
    """Return a world in the format of the page's engine, with null for no water."""
    values = {
        name: stored(value) if isinstance(value, np.ndarray) else value
        for name, value in terrain._asdict().items()
    }
    water = terrain.water_y if np.isfinite(terrain.water_y) else None
    return {**values, "water_y": water}


def episode(body: str, environment: str, seed: int, steps: int) -> dict[str, Any]:
    """Play an episode whose task, world and actions depend only on the seed."""
    world = make_environment(environment, embodiment=body).unwrapped
    rng = np.random.default_rng(seed)
    terrain = world.build(world.task_space.sample(rng), rng)
    push, size = rng.uniform(-PUSH, PUSH), world.embodiment.action_size
    pace = rng.integers(1, 12)  # repeated actions move a body further
    actions = np.repeat(rng.uniform(-1.2, 1.2, (steps // pace + 1, size)), pace, axis=0)[:steps]
    engine = world._engine
    first = engine.reset(terrain, push).tolist()
    played: list[dict[str, Any]] = []
    for action in actions:
        observation, reward, ended = engine.step(action)
        state = engine.state.ravel().tolist()
        played.append({"state": state, "observation": observation.tolist(), "reward": reward, "ended": ended})
        if ended:
            break
    given = {"terrain": world_record(terrain), "push": push, "actions": actions[: len(played)].tolist()}
    return given | {"first": first, "steps": played}


def main(folder: str, episodes: str, steps: str, *bodies: str) -> None:
    """Write a file of episodes for every body and environment."""
    for body in bodies:
        for environment in PLAYED:
            content = {
                "body": body_record(load_embodiment(body), environment),
                "constants": constants()["engine"],
                "episodes": [episode(body, environment, seed, int(steps)) for seed in range(int(episodes))],
            }
            (Path(folder) / f"{body}-{environment}.json").write_text(json.dumps(content))


if __name__ == "__main__":
    main(*sys.argv[1:])
