"""Gymnasium environment with episodes of a few steps, for many episodes in a small budget."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from tma_ray.tasks import TaskSpace, check_task


class Corridor(gymnasium.Env[np.ndarray, np.ndarray]):
    """Corridor to walk against a gusty wind; the task is its length and the strength of the wind."""

    task_space = TaskSpace.from_bounds({"distance": (1, 8), "wind": (0, 0.5)})
    valid_domain = task_space
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        assert options is not None
        self.distance, self.wind = check_task(options["task"], self.valid_domain).tolist()
        self.position, self.steps = 0.0, 0
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        move = float(action[0]) - self.wind * float(self.np_random.random())
        self.position += move
        self.steps += 1
        reward = 40 * move / self.distance - 0.1 * abs(float(action[1]))
        over = self.position >= self.distance or self.position < -3
        return self._observe(), reward, over, self.steps >= 30 and not over, {"success": False}

    def _observe(self) -> np.ndarray:
        return np.array([self.distance - self.position, self.wind, self.steps / 30], dtype=np.float32)
