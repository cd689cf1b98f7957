"""Parkour: uneven ground, ceiling, creepers and water (paper, section 4.2, appendix B)."""

from pathlib import Path

import numpy as np

from tma_ray.embodiments import Embodiment, LidarLayout
from tma_ray.envs.base import BodyEnvironment, embodiment_of
from tma_ray.physics import Rules
from tma_ray.tasks import Task, TaskSpace
from tma_ray.terrain import Terrain
from tma_ray.terrain.parkour import CPPN, DEFAULT_WEIGHTS, parkour

_UNITS = dict.fromkeys(("theta_1", "theta_2", "theta_3"), "input of the CPPN") | {
    "water_level": "share of the height up to the ceiling's highest point",
    "creepers_width": "m",
    "creepers_height": "m",
    "creepers_spacing": "m",
    "terrain_cppn_scale": "units of the CPPN per m",
}


class Parkour(BodyEnvironment):
    """Environment with uneven ground, a ceiling, creepers to climb on, and water.

    Observations are the head's angle and velocities; whether the head is under water, and whether the body is
    dead; each joint's angle, speed and contact; what each grip sensor touches and holds (0 or 1 each); ten
    lidars, and what each hits (-1 water, 1 a creeper, 0 ground, ceiling or nothing). Reward is progress
    minus head tilt and the cost of actions. A body dies after too many consecutive steps in the wrong medium:
    its actions become 0 until the episode ends. Ground contact of a critical part (a climber's) ends the
    episode with -100; so does passing the goal, without a bonus. Bodies with grip sensors start hanging from
    the ceiling. Actions, `reset`, `info` and attributes are those of `BodyEnvironment`; `task_space` is the
    paper's medium space (appendix C) with our own weights of the CPPN.

    Args:
        embodiment: a body, its name or the path of its file, with optional parameters ("fish:size=1.5").
        render_mode: None, "rgb_array" or "human".
        lidars: directions of the lidars; None for the body's own.
        cppn_weights: path of an ``.npz`` file with weights of the CPPN.
        swinging_creepers: True for creepers that are swinging chains (not used in the paper).

    Raises:
        ValueError: if the layout of lidars is unknown or the file has no weights.

    Examples:
        >>> import gymnasium
        >>> import tma_ray.envs  # registers the environment
        >>> env = gymnasium.make("tma_ray/Parkour-v0", embodiment="fish")
        >>> observation, info = env.reset(seed=1)
        >>> observation.shape, env.action_space.shape
        ((38,), (4,))
    """

    algorithm_version = 1
    task_space = TaskSpace.from_bounds(
        {
            "theta_1": (-0.35, 0.05),
            "theta_2": (0.6, 1.0),
            "theta_3": (-0.1, 0.3),
            "water_level": (0, 1),
            "creepers_width": (0.25, 0.25),
            "creepers_height": (0, 4),
            "creepers_spacing": (0, 5),
            "terrain_cppn_scale": (10, 10),
        },
        _UNITS,
    )
    valid_domain = TaskSpace.from_bounds(
        {
            "theta_1": (-2, 2),
            "theta_2": (-2, 2),
            "theta_3": (-2, 2),
            "water_level": (0, 1),
            "creepers_width": (0, 1),
            "creepers_height": (0, 4),
            "creepers_spacing": (0, 5),
            "terrain_cppn_scale": (2, 40),
        },
        _UNITS,
    )

    def __init__(
        self,
        embodiment: str | Path | Embodiment = "classic_bipedal",
        render_mode: str | None = None,
        lidars: LidarLayout | str | None = None,
        cppn_weights: str | Path = DEFAULT_WEIGHTS,
        swinging_creepers: bool = False,
    ) -> None:
        body = embodiment_of(embodiment)
        if lidars is not None and lidars not in list(LidarLayout):
            raise ValueError(f"lidars {lidars!r}: expected one of {', '.join(LidarLayout)}")
        layout = body.lidars if lidars is None else LidarLayout(lidars)
        self._cppn = CPPN.load(cppn_weights)
        self._swinging_creepers = swinging_creepers
        super().__init__(body, Rules("parkour", layout, observes_medium=True), render_mode)

    def build(self, task: Task, rng: np.random.Generator) -> Terrain:
        """Return the terrain of `task`, with one height per creeper drawn from `rng`."""
        return parkour(task, rng, cppn=self._cppn, swinging_creepers=self._swinging_creepers)
