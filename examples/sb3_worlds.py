"""Worlds of tma_ray as a vector environment of stable-baselines3, with a new task in every episode.

python examples/sb3_worlds.py
"""

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import tma_ray  # noqa: F401  (registers the environments)


class SB3Worlds(VecEnv):
    """Vector environment of stable-baselines3 around one of Gymnasium, with all of its `info`.

    Args:
        worlds: environment of `gymnasium.make_vec`, with ``autoreset_mode="SameStep"``.
    """

    def __init__(self, worlds: VectorEnv) -> None:
        if worlds.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"{worlds.metadata['autoreset_mode']}: make worlds with autoreset_mode='SameStep'"
            )
        self.worlds = worlds
        super().__init__(worlds.num_envs, worlds.single_observation_space, worlds.single_action_space)

    def reset(self):
        seed, self._seeds = self._seeds[0], [None] * self.num_envs
        observations, info = self.worlds.reset(seed=seed)
        self.reset_infos = self._rows(info)
        return observations

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, info = self.worlds.step(self.actions)
        over, final, last = terminated | truncated, info.pop("final_info", {}), info.pop("final_obs", None)
        infos = self._rows(info)
        for row in np.flatnonzero(over):
            self.reset_infos[row] = infos[row]
            infos[row] = self._row(final, row) | {"terminal_observation": last[row]}
            infos[row]["TimeLimit.truncated"] = bool(truncated[row] and not terminated[row])
        return observations, rewards, over, infos

    def close(self):
        self.worlds.close()

    def get_attr(self, attr_name, indices=None):
        values = self.worlds.get_attr(attr_name)
        return [values[row] for row in self._get_indices(indices)]

    def set_attr(self, attr_name, value, indices=None):
        values = list(self.worlds.get_attr(attr_name))
        for row in self._get_indices(indices):
            values[row] = value
        self.worlds.set_attr(attr_name, values)

    def env_method(self, method_name, *args, indices=None, **kwargs):
        results = self.worlds.call(method_name, *args, **kwargs)
        return [results[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * len(list(self._get_indices(indices)))

    def _rows(self, info):
        return [self._row(info, row) for row in range(self.num_envs)]

    def _row(self, info, row):
        return {key: info[key][row] for key in info if f"_{key}" in info and info[f"_{key}"][row]}


def main(steps: int = 20_000) -> None:
    """Train PPO on uniformly drawn tasks."""
    worlds = gymnasium.make_vec("tma_ray/StumpTracks-v0", num_envs=8, autoreset_mode="SameStep")
    environment = VecMonitor(SB3Worlds(worlds))
    PPO("MlpPolicy", environment, n_steps=256, seed=0, device="cpu", verbose=1).learn(steps)


if __name__ == "__main__":
    main()
