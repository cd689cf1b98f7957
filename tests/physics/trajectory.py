"""Script that prints digests of trajectories: ``python trajectory.py embodiment ...``."""

import hashlib
import sys

import numpy as np
from parkour_worlds import parkour_rules, parkour_world

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import Engine, make_engine
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

GRIP_STEPS = 12
"""Number of steps for which random grips stay closed or open."""


def digest(engine: Engine, seed: int, steps: int = 150, terrain: Terrain | None = None) -> str:
    """Return a hash of all observations, rewards and states of a random episode."""
    rng, content = np.random.default_rng(seed), hashlib.sha256()
    if terrain is None:
        terrain = stump_tracks(np.array([1.5, 1.0], dtype=np.float32), rng)
    motors, grips = len(engine.arrays.motors), np.ones(len(engine.arrays.grips))
    content.update(engine.reset(terrain, 3.0).tobytes())
    for step in range(steps):
        if step % GRIP_STEPS == GRIP_STEPS - 1:
            grips = rng.choice([-1.0, 1.0], len(grips))
        action = np.concatenate([rng.uniform(-1, 1, motors), grips])
        observation, reward, ended = engine.step(action)
        content.update(observation.tobytes() + np.float64(reward).tobytes() + bytes([ended]))
        content.update(engine.state.tobytes() + engine.contacts.tobytes())
        content.update(engine.grips.tobytes() + engine.medium.tobytes())
    return content.hexdigest()


def digest_in_parkour(name: str) -> str:
    """Return a hash of a random episode of a body among swinging creepers over water."""
    body = load_embodiment(name)
    terrain = parkour_world(0.8, (1.0, 2.0, 0.0), swinging=True)
    return digest(make_engine(body, parkour_rules(body)), 1, 40, terrain)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        trajectory = digest(make_engine(load_embodiment(name), RULES), seed=1)
        sys.stdout.write(f"{name} {trajectory} {digest_in_parkour(name)}\n")
