"""Stump Tracks: walk over stumps to the end of the track (paper, section 4.1 and appendix B)."""

from pathlib import Path

import numpy as np

from tma_ray.embodiments import Embodiment, LidarLayout
from tma_ray.envs.base import BodyEnvironment, embodiment_of
from tma_ray.physics import Rules
from tma_ray.tasks import Task, TaskSpace
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

RULES = Rules("stump_tracks", LidarLayout.DOWN, observes_medium=False)
"""All bodies look down and ahead, as in the original release."""

_UNITS = {"stump_height": "terrain steps", "obstacle_spacing": "m"}


class StumpTracks(BodyEnvironment):
    """A body on flat ground with stumps, whose height and spacing are the task.

    Observations are the head's angle and velocities, each joint's angle, speed and (feet only) contact, what
    grip sensors touch and hold, and ten lidars looking down and ahead. Reward is progress, less head tilt and
    torque cost. Touching anything with the head ends the episode with -100; passing the goal ends it too.
    See `BodyEnvironment` for actions, `reset` and `info`.

    Args:
        embodiment: a body's name or the path of its file, each with parameters if wanted (as in
            "spider:pairs_of_legs=3"), or the body itself.
        render_mode: None, "rgb_array" or "human".

    Attributes:
        algorithm_version: part of the identity of every run; see `BodyEnvironment`.
        task_space: tasks that a teacher may choose (paper, appendix B); `reset` accepts more.
        valid_domain: tasks that `reset` accepts: those of every challenge.
        max_episode_steps: steps after which an episode is truncated.

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
        """Return the world of `task`; `rng` draws one height per stump."""
        return stump_tracks(task, rng)
