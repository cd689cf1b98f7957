"""The state of live play, without anything that is seen: tasks, episodes, speed."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from tma_ray.tasks import Task, check_task
from tma_ray.viewing.rendering import RenderedEnvironment

SPEEDS: Final = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""How many times as fast as the world's own time a session can go."""

REST: Final = 1.5
"""Seconds for which the end of an episode is seen before the next one begins."""

LONGEST_WAIT: Final = 0.1
"""Longest delay that is caught up with, s: a slow machine would fall behind ever more."""


class Session:
    """Episodes one after the other, of given tasks in turn, or of the one that was chosen last.

    Episode number k has the seed `seed` + k, and is the same whenever it is played.

    Args:
        rendered: the environment, with the policy that acts in it.
        tasks: to play (n, d).
        seed: of the first episode, and of random tasks.

    Attributes:
        rendered: the environment, with the policy that acts in it.
        tasks: that are played in turn.
        task: of this episode (d,).
        episode: its number.
        steps: taken in it.
        episodic_return: sum of its rewards.
        over: whether it has ended.
        paused: whether time stands still.
        speed: times as fast as the world's own time.
    """

    def __init__(self, rendered: RenderedEnvironment, tasks: Sequence[Task], seed: int = 0) -> None:
        self.rendered = rendered
        self.over = False
        self.tasks = [check_task(task, rendered.domain) for task in tasks]
        self.seed = seed
        self._random_tasks = np.random.default_rng([seed, 2])
        self.paused, self.speed = False, 1.0
        self._turn, self.episode = 0, 0
        self._begin()

    def _begin(self) -> None:
        self.task = self.tasks[self._turn]
        self._due, self._rested = 0.0, 0.0
        self.steps, self.episodic_return, self.over = 0, 0.0, False
        seed = self.seed + self.episode
        self._policy = self.rendered.acting_policy(np.random.default_rng([seed, 1]))
        self._observation, _ = self.rendered.environment.reset(seed=seed, options={"task": self.task})

    @property
    def mastered(self) -> bool:
        """True if the return so far is over the threshold."""
        return self.episodic_return > self.rendered.threshold

    def restart(self) -> None:
        """Begins the same episode again."""
        self._begin()

    def next(self) -> None:
        """Begins the next episode: of the next task."""
        self.episode += 1
        self._turn = (self._turn + 1) % len(self.tasks)
        self._begin()

    def choose(self, task: Task) -> None:
        """Begins an episode of `task`, which remains the only one.

        Raises:
            ValueError: the environment cannot build it.
        """
        self.tasks, self._turn = [check_task(task, self.rendered.domain)], 0
        self.episode += 1
        self._begin()

    def choose_randomly(self) -> None:
        """Begins an episode of a task drawn from the task space."""
        self.choose(self.rendered.space.sample(self._random_tasks))

    def change_speed(self, notches: int) -> None:
        """Changes the speed by so many of `SPEEDS`."""
        index = SPEEDS.index(self.speed) + notches
        self.speed = SPEEDS[min(max(index, 0), len(SPEEDS) - 1)]

    def step(self) -> None:
        """Takes one step, unless the episode is over."""
        if self.over:
            return
        action = self._policy(self._observation)
        self._observation, reward, terminated, truncated, _ = self.rendered.environment.step(action)
        self.steps += 1
        self.episodic_return += float(reward)
        self.over = bool(terminated or truncated)

    def advance(self, seconds: float) -> None:
        """Takes the steps that are due after so many more seconds; after a rest the next episode begins."""
        if self.paused:
            return
        if self.over:
            self._rested += seconds
            if self._rested >= REST:
                self.next()
            return
        self._due += min(seconds, LONGEST_WAIT) * self.speed * float(self.rendered.frame_rate)
        for _ in itertools.repeat(None, int(self._due)):
            self.step()
        self._due -= int(self._due)
