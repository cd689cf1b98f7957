"""Stump Tracks: flat ground with stumps (paper, section 4.1 and appendix B)."""

from pathlib import Path

import numpy as np

from tma_ray.embodiments import Embodiment, LidarLayout
from tma_ray.envs.base import BodyEnvironment, embodiment_of
from tma_ray.physics import Rules
from tma_ray.tasks import Task, TaskSpace
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

# the lidars of all bodies point down and ahead, as in the original release
RULES = Rules("stump_tracks", LidarLayout.DOWN, observes_medium=False)

_UNITS = {"stump_height": "terrain steps", "obstacle_spacing": "m"}


class StumpTracks(BodyEnvironment):
    """Environment with flat ground and stumps; the task is their height and spacing.

    Observations are the head's angle and velocities, each joint's angle, speed and (feet only) contact, what
    grip sensors touch and hold, and ten lidars down and ahead. Reward is progress minus head tilt and torque
    cost. A contact of the head ends the episode with -100; so does passing the goal, without a penalty.
    Actions, `reset`, `info` and attributes are those of `BodyEnvironment`.

    Args:
        embodiment: a body, its name or the path of its file, with optional parameters
            ("spider:pairs_of_legs=3").
        render_mode: None, "rgb_array" or "human".

    Examples:
        >>> import gymnasium
        >>> import tma_ray.envs  # registers the environment
        >>> env = gymnasium.make("tma_ray/StumpTracks-v0", embodiment="classic_bipedal")
        >>> observation, info = env.reset(seed=1, options={"task": [1.5, 3.0]})
        >>> observation.shape, info["task"].tolist()
        ((24,), [1.5, 3.0])
    """

    algorithm_version = 1
    task_space = TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)}, _UNITS)
    valid_domain = TaskSpace.from_bounds({"stump_height": (-3, 9), "obstacle_spacing": (0, 6)}, _UNITS)

    def __init__(
        self, embodiment: str | Path | Embodiment = "classic_bipedal", render_mode: str | None = None
    ) -> None:
        super().__init__(embodiment_of(embodiment), RULES, render_mode)

    def build(self, task: Task, rng: np.random.Generator) -> Terrain:
        """Return the terrain of `task`, with one height per stump drawn from `rng`."""
        return stump_tracks(task, rng)
