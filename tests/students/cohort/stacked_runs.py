"""Small stacked learners of PPO and SAC, with runs that depend only on a seed."""

from typing import Any

import numpy as np
import torch
from stock_models import ACTION, OBSERVATION

from tma_ray.students.cohort.ppo import PPONetworks, StackedPPO
from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters
from tma_ray.students.mlp.layout import Layout

CPU = torch.device("cpu")
WIDTH, HIDDEN = 3, (20, 12)


def weights(seed: int, *shape: int) -> np.ndarray:
    return 0.2 * np.random.default_rng(seed).normal(size=shape).astype(np.float32)


class PPO:
    """Stacked PPO; `learn` stores a rollout of 40 steps for 3 epochs of 2 mini-batches."""

    values: dict[str, Any] = {"hidden_units": HIDDEN, "steps_per_update": 40, "batch_size": 20, "epochs": 3}

    @classmethod
    def learner(cls, changes: dict[str, Any] | None = None, **options: Any) -> StackedPPO:
        hyper = PPOHyperparameters(**{**cls.values, **(changes or {})})
        return StackedPPO((OBSERVATION, ACTION), hyper, WIDTH, CPU, **options)

    @classmethod
    def networks(cls, seed: int) -> PPONetworks:
        layout = PPOHyperparameters(**cls.values).layout(OBSERVATION, ACTION)
        parameters = weights(seed, layout.parameters + ACTION)
        return PPONetworks(parameters, np.zeros_like(parameters), np.zeros_like(parameters), 0)

    @staticmethod
    def join(stacked: StackedPPO, slot: int, networks: PPONetworks, run: int) -> None:
        stacked.join(slot, networks)

    @classmethod
    def learn(cls, stacked: StackedPPO, slot: int, seed: int, epochs: int = 3) -> None:
        stacked.store(slot, *cls.experience(seed, epochs))

    @staticmethod
    def experience(seed: int, epochs: int) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Return a rollout with probability ratios on both sides of PPO's clip range."""
        rng = np.random.default_rng(seed)
        observations = rng.normal(size=(40, OBSERVATION)).astype(np.float32)
        actions = rng.normal(size=(40, ACTION)).astype(np.float32)
        likely = -0.5 * np.square(actions).sum(axis=1) - 0.5 * ACTION * np.log(2 * np.pi)
        values, advantages, returns = 0.3 * rng.normal(size=(3, 40)).astype(np.float32)
        shaken = (likely + 0.3 * rng.normal(size=40)).astype(np.float32)
        orders = np.stack([rng.permutation(40) for _ in range(epochs)])
        return (observations, actions, values, shaken, advantages, returns), orders

    @staticmethod
    def move(stacked: StackedPPO, slot: int, other: StackedPPO, place: int) -> None:
        other.join(place, stacked.networks(slot))


class SAC:
    """Stacked SAC; `learn` stores an episode of 30 steps for 6 updates, and `join` one episode."""

    @staticmethod
    def learner(changes: dict[str, Any] | None = None, **options: Any) -> StackedSAC:
        hyper = SACHyperparameters(**{"hidden_units": HIDDEN, "batch_size": 16, **(changes or {})})
        return StackedSAC((OBSERVATION, ACTION), hyper, WIDTH, 60, CPU, **options)

    @staticmethod
    def networks(seed: int) -> SACNetworks:
        actor = SACHyperparameters(hidden_units=HIDDEN).layout(OBSERVATION, ACTION)
        critic = Layout((OBSERVATION + ACTION, *HIDDEN, 1))
        critics = weights(seed + 100, 2, critic.parameters)
        return untrained(weights(seed, actor.parameters), critics, critics.copy())

    @classmethod
    def join(cls, stacked: StackedSAC, slot: int, networks: SACNetworks, run: int) -> None:
        stacked.join(slot, networks, key=2**40 * run + 7)
        cls.learn(stacked, slot, run, updates=0)

    @staticmethod
    def learn(stacked: StackedSAC, slot: int, seed: int, updates: int = 6, length: int = 30) -> None:
        rng = np.random.default_rng(seed)
        observations = rng.normal(size=(length + 1, OBSERVATION)).astype(np.float32)
        actions = rng.uniform(-1, 1, (length, ACTION)).astype(np.float32)
        stacked.store(slot, observations, actions, rng.normal(size=length).astype(np.float32), seed % 2 == 0)
        stacked.owe(slot, updates)

    @staticmethod
    def move(stacked: StackedSAC, slot: int, other: StackedSAC, place: int) -> None:
        other.join(place, stacked.networks(slot), key=2**40 + 7)
        for piece in stacked._replay.pieces(slot):
            other.store(place, *piece)


def untrained(actor: np.ndarray, critics: np.ndarray, targets: np.ndarray) -> SACNetworks:
    moments = [np.zeros_like(part) for part in (actor, actor, critics, critics)]
    return SACNetworks(actor, critics, targets, *moments, 0, 0)


def enter(kind: Any, stacked: Any, slot: int, run: int) -> None:
    kind.join(stacked, slot, kind.networks(run), run)


def assert_same_bits(ours: Any, theirs: Any) -> None:
    for own, other in zip(ours, theirs, strict=True):
        assert np.asarray(own).tobytes() == np.asarray(other).tobytes()
