"""PPO of stable-baselines3 on a pendulum of many masses and lengths: ALP-GMM against Random.

python examples/sb3_pendulum.py
"""

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from tma_ray.curriculum import Curriculum

SPACE = {"mass": (0.2, 3.0), "length": (0.4, 2.0)}  # kg, m
MASTERY_RETURN = -300.0
SETTINGS = {"gamma": 0.9, "learning_rate": 1e-3, "n_steps": 256, "batch_size": 256, "use_sde": True}


def set_task(environment, task) -> None:
    environment.unwrapped.m, environment.unwrapped.l = task["mass"], task["length"]


def train(teacher: str, seed: int = 0, steps: int = 100_000, test_tasks: int = 50) -> float:
    """Train PPO with a teacher, and return the share of uniform test tasks that it masters."""
    curriculum = Curriculum(teacher, SPACE, mastery_return=MASTERY_RETURN, seed=seed, gamma=SETTINGS["gamma"])
    worlds = make_vec_env(lambda: curriculum.wrap(gymnasium.make("Pendulum-v1"), set_task), n_envs=4)
    model = PPO("MlpPolicy", worlds, seed=seed, device="cpu", **SETTINGS).learn(steps)
    curriculum.save(f"pendulum/{teacher.partition(':')[0]}-{seed}")
    tests = Curriculum("random", SPACE, mastery_return=MASTERY_RETURN, seed=1_000)
    test_environment = tests.wrap(gymnasium.make("Pendulum-v1"), set_task)
    test_environment.reset(seed=0)
    evaluate_policy(model, test_environment, n_eval_episodes=test_tasks, warn=False)
    return float(tests.episodes["success"].mean())


if __name__ == "__main__":
    for name in ("random", "alp_gmm:fit_every=25"):
        print(name, [train(name, seed) for seed in range(5)])
