"""Example of a student from scratch: a linear policy trained by hill climbing."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from tma_ray.students import STUDENTS, Student, Transition, read_policy, write_policy


@dataclass(frozen=True)
class Hyperparameters:
    """Hyper-parameters of the hill climber; other names or types of values are refused."""

    gamma: float = 0.99  # discount factor
    spread: float = 0.1  # standard deviation of a change of a weight


@STUDENTS.register("hill_climber")
class HillClimber(Student):
    """Plays each episode with changed weights, and keeps them if the return is the best so far."""

    hyperparameters_type = Hyperparameters

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        hyperparameters: Hyperparameters,
        seed: np.random.SeedSequence,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        self.observation_space, self.action_space = observation_space, action_space
        self.hyperparameters, self.gamma = hyperparameters, hyperparameters.gamma
        self.rng = np.random.default_rng(seed)  # the only source of randomness
        self.reset()

    def reset(self) -> None:
        self.best = np.zeros((*self.action_space.shape, *self.observation_space.shape), np.float32)
        self.best_return, self.episodic_return = -np.inf, 0.0
        self.trial = self._changed()

    def act(self, observation: np.ndarray) -> np.ndarray:
        return np.tanh(self.trial @ observation)

    def act_greedily(self, observations: np.ndarray) -> np.ndarray:
        return np.tanh(observations @ self.best.T)

    def observe(self, transition: Transition) -> None:
        self.episodic_return += transition.reward
        if transition.terminated or transition.truncated:
            if self.episodic_return > self.best_return:
                self.best, self.best_return = self.trial, self.episodic_return
            self.trial, self.episodic_return = self._changed(), 0.0

    def state_values(self, observations: np.ndarray) -> np.ndarray:
        return np.full(len(observations), max(self.best_return, -1e6))  # the same for all observations

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        np.savez(folder / "weights.npz", best=self.best, trial=self.trial)
        others = {"rng": self.rng.bit_generator.state, "best_return": self.best_return}
        (folder / "others.json").write_text(json.dumps(others))
        return ()  # all files were saved

    def load(self, folder: Path) -> None:
        with np.load(folder / "weights.npz") as weights:
            self.best, self.trial = weights["best"], weights["trial"]
        others = json.loads((folder / "others.json").read_text())
        self.rng.bit_generator.state, self.best_return = others["rng"], others["best_return"]

    def save_policy(self, folder: Path) -> None:
        boxes = self.observation_space, self.action_space
        write_policy(folder, "hill_climber", *boxes, {"weight": self.best}, asdict(self.hyperparameters))

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Callable[[Any], Any]:
        stored = read_policy(folder, "hill_climber")  # refuses other files, formats and students
        stored.check({"weight": (stored.action_space.shape + stored.observation_space.shape, "float32")})
        weight = stored.tensors["weight"]
        return lambda observations: np.tanh(observations @ weight.T)

    def _changed(self) -> np.ndarray:
        change = self.rng.normal(0, self.hyperparameters.spread, self.best.shape)
        return self.best + change.astype(np.float32)
