"""Example of an environment: Gymnasium's pendulum, with mass and length as the task."""

from typing import Any

import numpy as np
from gymnasium.envs.classic_control import PendulumEnv
from numpy.typing import NDArray

from tma_ray.tasks import TaskSpace, check_task

UNITS = {"mass": "kg", "length": "m"}


class SwingUp(PendulumEnv):
    """Swing a pendulum up with a weak motor, and hold it there; heavier and longer is harder.

    A teacher chooses from `task_space`. `reset` builds whatever lies in the larger `valid_domain`, so
    that a test set may ask for more. An episode is truncated after 200 steps of 0.05 s. Rewards are
    costs (angle, speed, torque), so a return over -200 is good: without `mastery_return` tasks would
    have to reach the benchmark's 230, which is impossible here.
    """

    task_space = TaskSpace.from_bounds({"mass": (0.2, 2), "length": (0.3, 1.5)}, UNITS)
    valid_domain = TaskSpace.from_bounds({"mass": (0.05, 5), "length": (0.1, 3)}, UNITS)
    mastery_return = -200.0
    max_episode_steps = 200

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset the pendulum to ``options={"task": [mass, length]}``, by default to a random task."""
        observation, info = super().reset(seed=seed)
        task = (options or {}).get("task")
        task = self.task_space.sample(self.np_random) if task is None else check_task(task, self.valid_domain)
        self.m, self.l = (float(value) for value in task)
        self.steps = 0
        return observation, {**info, "task": task}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance by 0.05 s; episodes are truncated, and never terminate."""
        observation, reward, terminated, _, info = super().step(action)
        self.steps += 1
        return observation, float(reward), terminated, self.steps >= self.max_episode_steps, info
