"""Short and fast third-party environment, with mass and length set by a curriculum."""

from collections.abc import Mapping

import gymnasium
import numpy as np

from tma_ray.curriculum import Curriculum, TaskEvaluation
from tma_ray.tasks import TaskSpace

SPACE = TaskSpace.from_bounds({"mass": (0.5, 2.0), "length": (0.5, 1.5)})
MASTERY_RETURN = -50.0
LENGTH = 10  # steps of an episode


def make_pendulum() -> gymnasium.Env:
    return gymnasium.make("Pendulum-v1", max_episode_steps=LENGTH)


def set_task(environment: gymnasium.Env, task: Mapping[str, float]) -> None:
    environment.unwrapped.m, environment.unwrapped.l = task["mass"], task["length"]


def values(observations: np.ndarray) -> np.ndarray:
    return observations.sum(axis=1)


def act(observations: np.ndarray) -> np.ndarray:
    return np.zeros((len(observations), 1), np.float32)


def functions() -> dict[str, object]:
    """Return all functions that a teacher may need from a training loop."""
    evaluate = TaskEvaluation(make_pendulum, act, SPACE, MASTERY_RETURN, apply=set_task)
    return {"values": values, "act": act, "evaluate": evaluate}


def curriculum_of(teacher: object, seed: int = 0) -> Curriculum:
    known = {"expert_knowledge": "high", "easy_task": np.array([0.5, 0.5]), "seed": seed}
    return Curriculum(teacher, SPACE, mastery_return=MASTERY_RETURN, **known, **functions())


def play(environment: gymnasium.Env, episodes: int, seed: int = 0) -> list[tuple[list[float], float]]:
    """Play episodes with random actions, and return their tasks and returns."""
    rng, played = np.random.default_rng(seed), []
    for episode in range(episodes):
        _, info = environment.reset(seed=seed + episode)
        episodic_return, over = 0.0, False
        while not over:
            action = rng.uniform(-2, 2, 1).astype(np.float32)
            _, reward, terminated, truncated, last = environment.step(action)
            episodic_return += reward
            over = terminated or truncated
        assert last["is_success"] == (episodic_return > MASTERY_RETURN)
        played.append((info["task"].tolist(), episodic_return))
    return played
