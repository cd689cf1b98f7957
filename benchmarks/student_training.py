"""Training steps per processor second of our loop and of stable-baselines3's `learn`.

Measured alternately in one process with one torch thread, by processor time, for a ratio that is reliable on
a busy machine. Both variants of SAC update their networks every 10 steps, not at the end of an episode, which
a short measurement may not reach; the number of updates is the same on average:

    python benchmarks/student_training.py --students ppo sac --precisions highest medium

"medium" rounds matrix products to bfloat16 where the processor has AMX; stable-baselines3 stays at float32.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from torch import nn

from tma_ray.students import Student, Transition, default_hyperparameters, make_student
from tma_ray.students.hyperparameters import MatmulPrecision
from tma_ray.students.ppo import Trunk


class OurLoop:
    """Training loop of a student on one environment, as in a run."""

    def __init__(self, student: Student, env: gymnasium.Env[Any, Any]) -> None:
        self.student, self.env = student, env
        self.observation = env.reset(seed=0)[0]

    def train(self, steps: int) -> None:
        """Continue training for `steps` steps."""
        student, env, observation = self.student, self.env, self.observation
        for _ in range(steps):
            action = student.act(observation)
            following, reward, terminated, truncated, _ = env.step(action)
            student.observe(Transition(observation, action, float(reward), following, terminated, truncated))
            observation = env.reset()[0] if terminated or truncated else following
        self.observation = observation


class StockLoop:
    """Training by stable-baselines3's `learn`, with the same hyper-parameters."""

    def __init__(self, name: str, env_name: str, values: dict[str, Any]) -> None:
        self.model = stock_ppo(env_name, values) if name == "ppo" else stock_sac(env_name, values)

    def train(self, steps: int) -> None:
        """Continue training for `steps` steps, rounded up to whole rollouts for PPO."""
        self.model.learn(steps, reset_num_timesteps=False)


def stock_ppo(env_name: str, values: dict[str, Any]) -> stable_baselines3.PPO:
    """Return stable-baselines3's PPO with the hyper-parameters `values`, normalised by VecNormalize."""
    env = VecNormalize(DummyVecEnv([lambda: gymnasium.make(env_name)]))
    trunk = {"hidden_units": tuple(values["hidden_units"])}
    return stable_baselines3.PPO(
        "MlpPolicy",
        env,
        learning_rate=values["learning_rate"],
        n_steps=values["steps_per_update"],
        batch_size=values["batch_size"],
        n_epochs=values["epochs"],
        clip_range_vf=values["value_clip_range"],
        policy_kwargs={
            "net_arch": [],
            "activation_fn": nn.ReLU,
            "features_extractor_class": Trunk,
            "features_extractor_kwargs": trunk,
        },
        seed=0,
        device="cpu",
    )


def stock_sac(env_name: str, values: dict[str, Any]) -> stable_baselines3.SAC:
    """Return stable-baselines3's SAC with the hyper-parameters `values`."""
    return stable_baselines3.SAC(
        "MlpPolicy",
        gymnasium.make(env_name),
        learning_rate=values["learning_rate"],
        buffer_size=values["buffer_size"],
        learning_starts=values["exploration_steps"],
        batch_size=values["batch_size"],
        train_freq=values["steps_per_update"],
        ent_coef=values["entropy_coefficient"],
        policy_kwargs={"net_arch": values["hidden_units"]},
        seed=0,
        device="cpu",
    )


def measure(name: str, precision: str, env_name: str, steps: int, repeats: int) -> dict[str, Any]:
    """Return the median speeds over `repeats` alternating stretches of `steps` steps, after a warm-up."""
    values = default_hyperparameters(name) | {"matmul_precision": precision}
    if name == "sac":
        values |= {"exploration_steps": 1_000, "updates": "interleaved"}
        values |= {"buffer_size": 200_000, "log_std": "clamp"}  # stable-baselines3 allocates the whole buffer
    env = gymnasium.make(env_name)
    student = make_student(name, env.observation_space, env.action_space, np.random.SeedSequence(0), values)
    loops: dict[str, OurLoop | StockLoop] = {
        "ours": OurLoop(student, env),
        "stock": StockLoop(name, env_name, values),
    }
    speeds: dict[str, list[float]] = {loop: [] for loop in loops}
    for repeat in range(repeats + 1):
        for loop, runner in loops.items():
            start = time.process_time()
            runner.train(steps if repeat else max(values["steps_per_update"], 2_000))
            if repeat:
                speeds[loop].append(steps / (time.process_time() - start))
    ratios = [ours / stock for ours, stock in zip(speeds["ours"], speeds["stock"], strict=True)]
    return {
        "student": name,
        "matmul_precision": precision,
        "environment": env_name,
        "ours_steps_per_second": round(statistics.median(speeds["ours"])),
        "stock_steps_per_second": round(statistics.median(speeds["stock"])),
        "ratio": round(statistics.median(ratios), 2),
        "ratios": [round(ratio, 2) for ratio in ratios],
    }


def main() -> None:
    """Print a line per student, and write the results as JSON."""
    parser = argparse.ArgumentParser(
        allow_abbrev=False, description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--students", nargs="+", default=["ppo", "sac"], choices=["ppo", "sac"])
    parser.add_argument(
        "--precisions", nargs="+", default=["highest", "medium"], choices=list(MatmulPrecision)
    )
    parser.add_argument("--environment", default="tma_ray.envs:tma_ray/StumpTracks-v0")
    parser.add_argument("--steps", type=int, help="steps per stretch (ppo 10,000, sac 1,000)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("student_training.json"))
    arguments = parser.parse_args()
    results = []
    for name in arguments.students:
        steps = arguments.steps or {"ppo": 10_000, "sac": 1_000}[name]
        for precision in arguments.precisions:
            results.append(measure(name, precision, arguments.environment, steps, arguments.repeats))
            print(json.dumps(results[-1]))
    machine = {
        "machine": platform.machine(),
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
        "amx": torch.cpu._is_amx_tile_supported(),
    }
    arguments.output.write_text(json.dumps({**machine, "results": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
