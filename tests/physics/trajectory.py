"""Prints digests of trajectories: ``python trajectory.py embodiment ...``; run in processes of their own."""

import hashlib
import sys

import numpy as np

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import Engine, make_engine
from tma_ray.terrain.stump_tracks import stump_tracks


def digest(engine: Engine, seed: int, steps: int = 150) -> str:
    """Returns a hash of every observation, reward and state of a random episode."""
    rng, content = np.random.default_rng(seed), hashlib.sha256()
    terrain = stump_tracks(np.array([1.5, 1.0], dtype=np.float32), rng)
    content.update(engine.reset(terrain, 3.0).tobytes())
    size = len(engine.arrays.motors) + len(engine.arrays.grips)
    for _ in range(steps):
        observation, reward, ended = engine.step(rng.uniform(-1, 1, size))
        content.update(observation.tobytes() + np.float64(reward).tobytes() + bytes([ended]))
        content.update(engine.state.tobytes() + engine.contacts.tobytes())
    return content.hexdigest()


if __name__ == "__main__":
    for name in sys.argv[1:]:
        trajectory = digest(make_engine(load_embodiment(name), RULES), seed=1)
        sys.stdout.write(f"{name} {trajectory}\n")
