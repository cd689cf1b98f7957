"""PPO's acting half. Imports no torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations, Transition
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.arrays import ArrayNetwork, FloatArray
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.normaliser import first_normaliser
from tma_ray.students.players.base import Player
from tma_ray.students.players.link import Weights
from tma_ray.students.ppo.acting import exploring_step, sampled_actions
from tma_ray.students.rollout import Rollout


class PPOPlayer(Player):
    """Acts as `tma_ray.students.ppo.student.PPO`, and hands over whole rollouts in the order of updates."""

    algorithm_version = PPOHyperparameters.algorithm_version
    hyperparameters_type = PPOHyperparameters

    def _layout(self, observation: int, action: int) -> Layout:
        layout: Layout = self.hyperparameters.layout(observation, action)
        return layout

    def _start(self) -> None:
        hyper, size = self.hyperparameters, self._observation_size
        self.normaliser = first_normaliser(hyper, size)
        self._rollout = Rollout(hyper.steps_per_update, size, self._low.size, self._batches)
        self._episode_starts = True
        self._average: FloatArray | None = None
        self._greedy = self._network
        if hyper.averaged_steps:
            self._greedy = ArrayNetwork(self._layout(size, self._low.size))

    def _take_over(self, weights: Weights) -> None:
        """Takes over the network's parameters and, after them, the log deviation (a,)."""
        count = self._low.size
        own = weights[:-count]
        self._network.load(own)
        if self.hyperparameters.averaged_steps:
            before = own if self._average is None else self._average
            self._put_average(before + np.float32(self.hyperparameters.averaging) * (own - before))
        self._policy = weights[-count:].copy(), np.stack([self._low, self._high])

    def _put_average(self, average: FloatArray) -> None:
        self._average = average
        self._greedy.load(average)

    def _forget(self) -> None:
        self._average = None
        self._rollout.clear()

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        if self._episode_starts:
            self.normaliser.update(observation)
        network = self._network.row.arrays
        self._step = exploring_step(network, self._policy, self.normaliser, observation, self._noise())
        return self._step.action

    def observe(self, transition: Transition) -> None:  # noqa: D102
        ended = transition.terminated or transition.truncated
        reward = self.normaliser.count_in(transition, self._value)
        step = self._step
        self._rollout.add(step.observation, step.sampled, reward, ended, step.judged)
        self._episode_starts = ended
        if self._rollout.is_full:
            self._hand_over(transition.next_observation)

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        means = self._greedy(self.normaliser.normalise(observations))[:, :-1]
        clipped: Actions = np.minimum(np.maximum(means, self._low), self._high)
        return clipped

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        means = self._network(self.normaliser.normalise(observations))[:, :-1]
        return sampled_actions(means, self._policy, rng)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Returns V(s) (n,) of `observations` (n, o), rescaled from normalised to raw rewards."""
        values = self._network(self.normaliser.normalise(observations))[:, -1].astype(np.float64)
        scaled: NDArray[np.float64] = values * self.normaliser.reward_scale
        return scaled

    def _value(self, observation: Observations) -> float:
        """Returns the value of one observation (o,), in normalised reward."""
        return float(self._network.row(self.normaliser.normalise(observation))[-1])

    def _hand_over(self, next_observation: Observations) -> None:
        hyper = self.hyperparameters
        self._rollout.finish(self._value(next_observation), self.gamma, hyper.gae_lambda)
        orders = np.stack([self._rollout.shuffled() for _ in range(hyper.epochs)])
        updates = hyper.epochs * (hyper.steps_per_update // hyper.batch_size)
        weights = self._link.learn((*self._rollout.columns(), orders), updates)
        assert weights is not None, "a rollout is followed by updates"
        self._take_over(weights)
        self._rollout.clear()

    def _experience(self) -> dict[str, Any]:
        state = {"normaliser": self.normaliser, "rollout": self._rollout.state()}
        return state | {"average": self._average}

    def _restore_experience(self, experience: dict[str, Any]) -> None:
        self.normaliser = experience["normaliser"]
        self._rollout.restore(experience["rollout"])
        if experience["average"] is not None:
            self._put_average(experience["average"])
        self._episode_starts = True  # states are saved at the end of an episode
