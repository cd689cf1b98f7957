"""Small environment and training loop for tests of students."""

import hashlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from tma_ray.students import Student, Transition, make_student
from tma_ray.support.component_names import base_name

OURS = ("ppo", "sac")
OFF_POLICY = {"buffer_size": 150, "batch_size": 20, "learning_starts": 60, "train_freq": 10}
OFF_POLICY["policy_kwargs"] = {"net_arch": [16, 8]}

SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"hidden_units": [16, 8], "steps_per_update": 50, "batch_size": 25, "epochs": 2},
    "sac": {"hidden_units": [16, 8], "buffer_size": 150, "batch_size": 20, "exploration_steps": 60},
    "A2C": {"policy_kwargs": {"net_arch": [16, 8]}, "n_steps": 20},
    "TRPO": {"policy_kwargs": {"net_arch": [16, 8]}, "n_steps": 60, "batch_size": 30},
    **dict.fromkeys(("CrossQ", "DDPG", "TD3", "TQC"), OFF_POLICY),
}
"""Hyper-parameters by student for tiny networks and early updates; others are the defaults."""


class Drift(gymnasium.Env):
    """Noisy linear system with asymmetric action bounds, random termination and truncation at `limit`."""

    def __init__(self, seed: int = 0, limit: int | None = 17, ending: float = 0.05) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
        self.action_space = spaces.Box(np.array([-2, -1], np.float32), np.array([1, 3], np.float32))
        self.limit, self.ending = limit, ending
        self.generator = np.random.default_rng(seed)

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.generator = np.random.default_rng(seed)
        self.state, self.steps = self.generator.normal(size=3), 0
        return self.state.astype(np.float32), {}

    def step(self, action):
        assert self.action_space.contains(action), action
        self.steps += 1
        self.state = 0.9 * self.state + 0.3 * self.generator.normal(size=3) + 0.2 * float(action.sum())
        terminated = bool(self.generator.random() < self.ending)
        truncated = self.limit is not None and self.steps >= self.limit
        reward = 3.0 - float(self.state @ self.state)
        return self.state.astype(np.float32), reward, terminated, truncated, {}


def small_student(name: str, seed: int = 0, **hyperparameters) -> Student:
    env = Drift()
    values = {**SMALL[base_name(name).removeprefix("stock:")], **hyperparameters}
    return make_student(name, env.observation_space, env.action_space, np.random.SeedSequence(seed), values)


def played(student: Student, env: gymnasium.Env, start: np.ndarray | None = None) -> Iterator[Transition]:
    """Train endlessly, from a reset or from `start`; yield the transitions."""
    observation = start
    while True:
        if observation is None:
            observation = env.reset()[0]
        action = student.act(observation)
        following, reward, terminated, truncated, _ = env.step(action)
        transition = Transition(observation, action, float(reward), following, terminated, truncated)
        student.observe(transition)
        yield transition
        observation = None if terminated or truncated else following


def train(student: Student, env: gymnasium.Env, steps: int) -> list[Transition]:
    """Train for a number of steps from a reset; return the transitions."""
    return list(islice(played(student, env), steps))


def actions_of(transitions: list[Transition]) -> np.ndarray:
    return np.stack([step.action for step in transitions])


def train_episodes(student: Student, episodes: range) -> list[float]:
    """Train for whole episodes, seeded by their numbers; return the episodic returns."""
    returns = []
    for episode in episodes:
        returns.append(0.0)
        for step in played(student, Drift(seed=episode)):
            returns[-1] += step.reward
            if step.terminated or step.truncated:
                break
    return returns


def differ(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> bool:
    return any((before[name] != value).any() for name, value in after.items())


def parameters(student: Student) -> dict[str, np.ndarray]:
    return {name: value.numpy().copy() for name, value in student.model.policy.state_dict().items()}


def digest(student: Student, folder: Path) -> dict[str, str]:
    """Return the hashes of all files that a student saves, by path."""
    folder.mkdir(parents=True, exist_ok=True)
    student.save(folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def resume(name: str, saved: str, episodes: range, work: str) -> tuple[list[float], dict[str, str]]:
    """Continue the training of a saved student; return episodic returns and hashes of its files."""
    student = small_student(name, seed=999)
    student.load(Path(saved))
    returns = train_episodes(student, episodes)
    return returns, digest(student, Path(work))
