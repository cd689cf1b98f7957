"""PPO of stable-baselines3 under robust PLR, which withholds some episodes from the updates.

python examples/sb3_withheld.py
"""

import gymnasium
import numpy as np
import torch
from sb3_pendulum import MASTERY_RETURN, SPACE, set_task
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer

from tma_ray.curriculum import Curriculum


class TrainingSteps(RolloutBuffer):
    """Rollout buffer without the steps that must not train."""

    def reset(self):
        super().reset()
        self.trains = np.ones((self.buffer_size, self.n_envs), np.bool_)

    def get(self, batch_size=None):
        next(super().get(1))  # flattens the arrays, environment by environment
        kept = np.random.permutation(np.flatnonzero(self.trains.T))  # noqa: NPY002 - as that of stable-baselines3
        for start in range(0, len(kept), batch_size or len(kept)):
            yield self._get_samples(kept[start:][:batch_size])


class WithholdingPPO(PPO):
    """PPO that does not learn from steps with a false ``info["trains"]``."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, rollout_buffer_class=TrainingSteps, **kwargs)

    def _update_info_buffer(self, infos, dones=None):
        super()._update_info_buffer(infos, dones)
        self.rollout_buffer.trains[self.rollout_buffer.pos] = [info["trains"] for info in infos]

    def train(self):
        if self.rollout_buffer.trains.any():
            super().train()


def main(teacher: str = "robust_plr", steps: int = 50_000, **settings) -> Curriculum:
    """Train PPO on the pendulum, and return the curriculum."""

    def values(observations):
        with torch.no_grad():
            return model.policy.predict_values(torch.as_tensor(observations)).numpy().ravel()

    curriculum = Curriculum(teacher, SPACE, mastery_return=MASTERY_RETURN, values=values, marks_withheld=True)
    environment = curriculum.wrap(gymnasium.make("Pendulum-v1"), set_task)
    model = WithholdingPPO("MlpPolicy", environment, seed=0, device="cpu", **settings)
    model.learn(steps)
    return curriculum


if __name__ == "__main__":
    print(main().episodes.groupby("trains")["episodic_return"].describe())
