"""Stump Tracks: walk over stumps to the end of the track (paper, section 4.1 and appendix B)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment, LidarLayout, load_embodiment
from tma_ray.physics import LIDARS, TIME_STEP, Engine, Rules, make_engine, observation_size
from tma_ray.tasks import MASTERY_RETURN, Task, TaskSpace, check_task
from tma_ray.terrain.stump_tracks import stump_tracks

if TYPE_CHECKING:
    from tma_ray.envs.rendering import Renderer

MAX_EPISODE_STEPS = 2000
"""Steps after which an episode is truncated (the original release leaves this to its students)."""

PUSH = 5.0
"""Largest random push on the head in the first step, in N."""

RULES = Rules("stump_tracks", LidarLayout.DOWN, observes_milieu=False)
"""All bodies look down and ahead, as in the original release."""

_UNITS = {"stump_height": "terrain steps", "obstacle_spacing": "m"}

Observation = NDArray[np.float32]


class StumpTracks(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A body on flat ground with stumps, whose height and spacing are the task.

    An action is one value in [-1, 1] per motor: its sign is the direction, its size the share of the torque.
    Observations are the head's angle and velocities, each joint's angle, speed and (feet only) contact, and
    ten lidars looking down and ahead. Reward is progress, less head tilt and torque cost. Touching
    anything with the head ends the episode with -100; passing the goal ends it too. An episode is a success
    when its return is over 230.

    `reset` takes a task (``options={"task": [height, spacing]}``) or draws one uniformly from `task_space`.
    `info` holds "success", and after `reset` also the "task". Seed and actions determine a trajectory bit for
    bit.

    Args:
        embodiment: a body's name or the path of its file, each with parameters if wanted (as in
            "spider:pairs_of_legs=3"), or the body itself.
        render_mode: None, "rgb_array" or "human".

    Attributes:
        task_space: tasks that a teacher may choose (paper, appendix B); `reset` accepts more.
        valid_domain: tasks that `reset` accepts: those of every challenge.
        max_episode_steps: steps after which an episode is truncated.

    Examples:
        >>> import tma_ray.envs  # registers the environment
        >>> env = gymnasium.make("tma_ray/StumpTracks-v0", embodiment="classic_bipedal")
        >>> observation, info = env.reset(seed=1, options={"task": [1.5, 3.0]})
        >>> observation.shape, info["task"].tolist()
        ((24,), [1.5, 3.0])
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": round(1 / TIME_STEP)}
    task_space = TaskSpace.from_bounds({"stump_height": (0, 3), "obstacle_spacing": (0, 6)}, _UNITS)
    valid_domain = TaskSpace.from_bounds({"stump_height": (-3, 9), "obstacle_spacing": (0, 6)}, _UNITS)
    max_episode_steps = MAX_EPISODE_STEPS

    def __init__(
        self, embodiment: str | Path | Embodiment = "classic_bipedal", render_mode: str | None = None
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r}: expected None, 'human' or 'rgb_array'")
        self.render_mode = render_mode
        self.embodiment = embodiment if isinstance(embodiment, Embodiment) else load_embodiment(embodiment)
        self._engine = make_engine(self.embodiment, RULES)
        size, actions = observation_size(self._engine.arrays), self.embodiment.action_size
        # Only lidars have bounds that always hold: a joint that is hit hard overshoots its limits.
        low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
        low[-LIDARS:], high[-LIDARS:] = 0.0, 1.0
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (actions,), dtype=np.float32)
        self._renderer: Renderer | None = None
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Builds the world of a task and returns its first observation.

        Args:
            seed: makes this episode, and those after it, repeatable.
            options: {"task": [mean stump height in terrain steps, gap between stumps in m]}.

        Raises:
            ValueError: a task outside `valid_domain`, or an unknown option.
        """
        super().reset(seed=seed)
        task = self._chosen_task(options or {})
        push = self.np_random.uniform(-PUSH, PUSH)
        self._terrain = stump_tracks(task, self.np_random)
        observation = self._engine.reset(self._terrain, push)
        self._observation = observation
        self._return, self._steps, self._running = 0.0, 0, True
        if self.render_mode == "human":
            self.render()
        return observation, {"success": False, "task": task}

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advances the world by 1/50 s.

        Raises:
            ValueError: an action of another shape, or not finite.
            gymnasium.error.ResetNeeded: the episode has ended, or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded("the episode has ended or not begun; call reset()")
        observation, reward, terminated = self._engine.step(action)
        self._observation = observation
        self._return += reward
        self._steps += 1
        truncated = not terminated and self._steps >= self.max_episode_steps
        self._running = not (terminated or truncated)
        if self.render_mode == "human":
            self.render()
        return observation, reward, terminated, truncated, {"success": self._return > MASTERY_RETURN}

    def hand_over(self) -> Engine:
        """Returns the engine, to play the episode that has begun without this environment.

        The environment itself must be reset before its next step.

        Raises:
            gymnasium.error.ResetNeeded: the episode has ended, or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded("the episode has ended or not begun; call reset()")
        self._running = False
        return self._engine

    def render(self) -> NDArray[np.uint8] | None:
        """Draws the world around the head: (400, 600, 3) for "rgb_array", a window for "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: make the environment with 'rgb_array'")
            return None
        from tma_ray.envs.rendering import Renderer, Scene  # here, so that training never loads pygame

        if self._renderer is None:
            window = self.render_mode == "human"
            self._renderer = Renderer(self.embodiment, window, self.metadata["render_fps"])
        poses = self._engine.state[:, :3]
        head = poses[self.embodiment.head, :2]
        lidars = head + self._observation[-LIDARS:, None] * self._engine.arrays.rays
        return self._renderer.draw(Scene(poses, self._terrain, lidars))

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _chosen_task(self, options: dict[str, Any]) -> Task:
        unknown = sorted(options.keys() - {"task"})
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; the only one is 'task'")
        if options.get("task") is None:
            return self.task_space.sample(self.np_random)
        return check_task(options["task"], self.valid_domain)
