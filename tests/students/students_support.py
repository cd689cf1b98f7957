"""A small environment and a plain training loop for the tests of students."""

from __future__ import annotations

import hashlib
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium import spaces

from tma_ray.part_names import base_name
from tma_ray.students import Student, Transition, make_student

SMALL = {
    "ppo": {"hidden_units": [16, 8], "steps_per_update": 50, "batch_size": 25, "epochs": 2},
    "sac": {"hidden_units": [16, 8], "buffer_size": 150, "batch_size": 20, "exploration_steps": 60},
}


class Drift(gymnasium.Env):
    """A noisy linear system with oddly bounded actions; ends by chance or is cut after `limit` steps."""

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
        self.state = 0.9 * self.state + 0.3 * self.generator.normal(size=3) + 0.2 * action.sum()
        terminated = bool(self.generator.random() < self.ending)
        truncated = self.limit is not None and self.steps >= self.limit
        reward = 3.0 - float(self.state @ self.state)
        return self.state.astype(np.float32), reward, terminated, truncated, {}


def small_student(name: str, seed: int = 0, **hyperparameters) -> Student:
    env = Drift()
    values = {**SMALL[base_name(name).removeprefix("stock:")], **hyperparameters}
    return make_student(name, env.observation_space, env.action_space, np.random.SeedSequence(seed), values)


def train(student: Student, env: gymnasium.Env, steps: int) -> list[Transition]:
    """Play from a reset for `steps` steps; return what happened."""
    observation, _ = env.reset()
    transitions = []
    for _ in range(steps):
        action = student.act(observation)
        following, reward, terminated, truncated, _ = env.step(action)
        transitions.append(Transition(observation, action, float(reward), following, terminated, truncated))
        student.observe(transitions[-1])
        observation = env.reset()[0] if terminated or truncated else following
    return transitions


def train_episodes(student: Student, episodes: range) -> list[float]:
    """Play whole episodes, each in a world seeded by its number; return their returns."""
    returns = []
    for episode in episodes:
        env = Drift(seed=episode)
        observation, over, total = env.reset()[0], False, 0.0
        while not over:
            action = student.act(observation)
            following, reward, terminated, truncated, _ = env.step(action)
            student.observe(Transition(observation, action, reward, following, terminated, truncated))
            observation, over, total = following, terminated or truncated, total + reward
        returns.append(total)
    return returns


def parameters(student: Student) -> dict[str, np.ndarray]:
    return {name: value.numpy().copy() for name, value in student.model.policy.state_dict().items()}


def digest(student: Student, folder: Path) -> dict[str, str]:
    """Hashes of everything the student saves, by file."""
    folder.mkdir(parents=True, exist_ok=True)
    student.save(folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def resume(name: str, saved: str, episodes: range, work: str) -> tuple[list[float], dict[str, str]]:
    """Continue a saved student and tell how it went on."""
    student = small_student(name, seed=999)
    student.load(Path(saved))
    returns = train_episodes(student, episodes)
    return returns, digest(student, Path(work))
