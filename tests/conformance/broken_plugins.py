"""Environment and student that break one requirement of plug-ins each, selected by `fault`."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np
from hill_climber import HillClimber
from swing_up import SwingUp


class BrokenSwingUp(SwingUp):
    """Pendulum that breaks the requirement named by `fault`."""

    def __init__(self, fault: str = "") -> None:
        super().__init__()
        self.fault = fault
        self.array = np.zeros(3, np.float32)

    def reset(self, *, seed=None, options=None):
        if self.fault == "accepts anything" and options:
            options = {"task": np.clip(options["task"], self.valid_domain.low, self.valid_domain.high)}
            options["task"] = np.nan_to_num(options["task"], nan=1.0)
        observation, info = super().reset(seed=seed, options=options)
        if self.fault == "keeps the task" and options:
            info["task"] = options["task"]
        if self.fault == "hides the task":
            info = {}
        if self.fault == "global randomness":
            observation = observation + np.float32(random.random() / 100)
        return observation, info

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if self.fault == "endless":
            truncated = False
        if self.fault == "one array":
            self.array[:] = observation
            observation = self.array[:]
        if self.fault == "no number":
            reward = float("nan")
        return observation, reward, terminated, truncated, info


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of the broken student."""

    gamma: float = 0.99
    spread: float = 0.1
    fault: str = ""


class BrokenClimber(HillClimber):
    """Hill climber that breaks the requirement named by `fault`."""

    hyperparameters_type = Settings

    def act(self, observation):
        action = super().act(observation)
        if self.hyperparameters.fault == "global randomness":
            action = action * np.float32(np.random.random())  # noqa: NPY002
        return action * 10 if self.hyperparameters.fault == "out of bounds" else action

    def act_greedily(self, observations):
        if self.hyperparameters.fault == "changes when asked":
            self.rng.random()
        return super().act_greedily(observations)

    def load(self, folder):
        before = self.rng.bit_generator.state
        super().load(folder)
        if self.hyperparameters.fault == "forgets its generator":
            self.rng.bit_generator.state = before
