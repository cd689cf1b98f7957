"""PPO of stable-baselines3 on MuJoCo's hopper of many masses and frictions: ALP-GMM against Random.

pip install "gymnasium[mujoco]"; python examples/sb3_hopper.py
"""

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from tma_ray.curriculum import Curriculum

SPACE = {"mass": (0.5, 3.0), "friction": (0.1, 2.0)}  # multiples of the usual ones
MASTERY_RETURN = 500.0
USUAL = gymnasium.make("Hopper-v5").unwrapped.model


def set_task(environment, task) -> None:
    model = environment.unwrapped.model
    model.body_mass[:] = task["mass"] * USUAL.body_mass
    model.geom_friction[:, 0] = task["friction"] * USUAL.geom_friction[:, 0]


def train(teacher: str, seed: int = 0, steps: int = 100_000, test_tasks: int = 50) -> float:
    """Train PPO with a teacher, and return the share of uniform test tasks that it masters."""
    curriculum = Curriculum(teacher, SPACE, mastery_return=MASTERY_RETURN, seed=seed)
    worlds = make_vec_env(lambda: curriculum.wrap(gymnasium.make("Hopper-v5"), set_task), n_envs=4)
    model = PPO("MlpPolicy", worlds, n_steps=512, seed=seed, device="cpu").learn(steps)
    curriculum.save(f"hopper/{teacher.partition(':')[0]}-{seed}")
    tests = Curriculum("random", SPACE, mastery_return=MASTERY_RETURN, seed=1_000)
    test_environment = tests.wrap(gymnasium.make("Hopper-v5"), set_task)
    test_environment.reset(seed=0)
    evaluate_policy(model, test_environment, n_eval_episodes=test_tasks, warn=False)
    return float(tests.episodes["success"].mean())


if __name__ == "__main__":
    for name in ("random", "alp_gmm:fit_every=50"):
        print(name, [train(name, seed) for seed in range(5)])
