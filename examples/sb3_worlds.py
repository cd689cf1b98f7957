"""Worlds of tma_ray as a vector environment of stable-baselines3, each episode on a task of its own.

python examples/sb3_worlds.py
"""

from collections.abc import Callable

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import tma_ray  # noqa: F401  (registers the environments)
from tma_ray.envs import VectorEnvironment


class SB3Worlds(VecEnv):
    """Steps all worlds in one call; an episode that is over is followed by one on the next task.

    Args:
        worlds: as `gymnasium.make_vec` makes them.
        next_task: returns the task of the next episode (d,).
    """

    def __init__(self, worlds: VectorEnvironment, next_task: Callable[[], np.ndarray]) -> None:
        self.worlds, self.next_task = worlds, next_task  # before stable-baselines3 asks for their render_mode
        super().__init__(worlds.num_envs, worlds.single_observation_space, worlds.single_action_space)

    def reset(self):
        seed, self._seeds = self._seeds[0], [None] * self.num_envs
        return self.worlds.reset(seed=seed, options={"task": self._tasks()})[0]

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, _ = self.worlds.step(self.actions)
        over, infos = terminated | truncated, [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(over):
            last = {"terminal_observation": observations[row]}
            infos[row] = {**last, "TimeLimit.truncated": bool(truncated[row])}
        if over.any():
            observations, _ = self.worlds.reset(options={"reset_mask": over, "task": self._tasks(over)})
        return observations, rewards, over, infos

    def close(self):
        self.worlds.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.worlds, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name, value, indices=None):
        raise AttributeError(f"worlds that are stepped together have no {attr_name} of their own to set")

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise AttributeError(f"worlds that are stepped together have no method {method_name} of their own")

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * len(list(self._get_indices(indices)))

    def _tasks(self, rows=None):
        rows = np.ones(self.num_envs, bool) if rows is None else rows
        tasks = np.zeros((self.num_envs, self.worlds.valid_domain.size))
        for row in np.flatnonzero(rows):
            tasks[row] = self.next_task()
        return tasks


def main(steps: int = 20_000) -> None:
    """Trains PPO on uniformly drawn tasks."""
    worlds, rng = gymnasium.make_vec("tma_ray/StumpTracks-v0", num_envs=8), np.random.default_rng(0)
    environment = VecMonitor(SB3Worlds(worlds, lambda: worlds.task_space.sample(rng)))
    PPO("MlpPolicy", environment, n_steps=256, seed=0, device="cpu", verbose=1).learn(steps)


if __name__ == "__main__":
    main()
