"""Wrappers of environments and vector environments that take tasks from a curriculum."""

import copy
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from tma_ray.curriculum.episodes import (
    Apply,
    Assignment,
    Environment,
    EpisodeUnderWay,
    Link,
    by_name,
    next_assignment,
    reset_to,
)
from tma_ray.envs import VectorEnvironment
from tma_ray.tasks import Task


class CurriculumEnvironment(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that takes the task of each episode from a curriculum.

    Each `reset` takes the next task, unless the caller's options have a "task". Episodes on such a task, or
    abandoned by `reset`, are not reported. `info` has the "task" (d,) after `reset`, "trains" in every step,
    which is False if the student must not learn from the episode, and "is_success" at its end.

    Args:
        env: environment to wrap.
        link: curriculum of the environment.
        apply: function that prepares the environment for a task; None if its `reset` takes the option "task".
    """

    def __init__(self, env: Environment, link: Link, apply: Apply | None = None) -> None:
        super().__init__(env)
        self._link, self._apply = link, apply
        self._episode: EpisodeUnderWay | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode on the next task of the curriculum, unless `options` has a "task"."""
        self._abandon()
        if options and "task" in options:
            return self.env.reset(seed=seed, options=options)
        assignment, seed = next_assignment(self.env, self._link, self._apply, seed)
        named = by_name(self._link.space, assignment.task)
        observation, info = reset_to(self.env, named, self._apply, seed=seed, options=options)
        self._episode = EpisodeUnderWay(assignment, observation, self._link.gamma)
        return observation, {**info, "task": assignment.task.copy(), "trains": assignment.trains}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step, and report the episode if it has ended."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        episode = self._episode
        if episode is not None:
            episode.add(action, float(reward), observation, terminated)
            info = {**info, "trains": episode.assignment.trains}
            if terminated or truncated:
                self._episode = None
                self._link.end(episode.played())
                info["is_success"] = episode.episodic_return > self._link.mastery_return
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Close the environment, and abandon its episode."""
        self._abandon()
        super().close()

    def _abandon(self) -> None:
        if self._episode is not None:
            self._link.abandon(self._episode.assignment.number)
            self._episode = None


class CurriculumWorlds(VectorWrapper):
    """Wrapper around a `VectorEnvironment` that takes tasks from a curriculum; see `wrap_vector`."""

    def __init__(self, env: VectorEnv[Any, Any, Any], link: Link) -> None:
        super().__init__(env)
        self._worlds: VectorEnvironment = env.unwrapped  # type: ignore[assignment]
        self._link = link
        self._spare = copy.deepcopy(self._worlds.envs[0])  # for episodes without learning
        self._spare_seed: int | None = None
        self._assigned: list[Assignment] = []
        self._episodes: list[EpisodeUnderWay | None] = [None] * self.num_envs
        self._over = np.zeros(self.num_envs, np.bool_)
        self._trains = np.ones(self.num_envs, np.bool_)
        self._worlds.next_task = self._next_task

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin episodes on the next tasks of the curriculum, unless `options` has a "task"."""
        mask = (options or {}).get("reset_mask")
        begun = np.ones(self.num_envs, np.bool_) if mask is None else np.asarray(mask)
        self._abandon(begun)
        self._assigned = []
        if seed is not None:
            self._spare_seed = seed if isinstance(seed, int) else seed[0]
        observations, info = self.env.reset(seed=seed, options=options)
        self._trains[begun] = True
        if "task" not in (options or {}):
            self._begin(begun, observations)
        self._over[begun] = False
        return observations, {**info, "trains": self._trains & begun, "_trains": begun.copy()}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take a step in every sub-environment, and report the episodes that end."""
        self._assigned = []
        observations, rewards, terminated, truncated, info = self.env.step(actions)
        mode, begun = self._worlds.autoreset_mode, self._over
        over, trained = terminated | truncated, self._trains.copy()
        for row in np.flatnonzero(~begun):
            episode = self._episodes[row]
            if episode is not None:
                same_step = mode is AutoresetMode.SAME_STEP and over[row]
                last = info["final_obs"][row] if same_step else observations[row]
                episode.add(actions[row], float(rewards[row]), last, bool(terminated[row]))
                if over[row]:
                    self._episodes[row] = None
                    self._link.end(episode.played())
        if mode is AutoresetMode.SAME_STEP:
            self._begin(over, observations)
            if over.any():
                info["final_info"] |= {"trains": trained & over, "_trains": over.copy()}
        else:
            self._begin(begun, observations)
            self._over = over
        info |= {"trains": self._trains.copy(), "_trains": np.ones(self.num_envs, np.bool_)}
        return observations, rewards, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Close the sub-environments, and abandon their episodes."""
        self._abandon(np.ones(self.num_envs, np.bool_))
        self._spare.close()
        super().close(**kwargs)

    def _abandon(self, mask: NDArray[np.bool_]) -> None:
        for row in np.flatnonzero(mask):
            episode, self._episodes[row] = self._episodes[row], None
            if episode is not None:
                self._link.abandon(episode.assignment.number)

    def _next_task(self) -> Task:
        assignment, self._spare_seed = next_assignment(self._spare, self._link, None, self._spare_seed)
        self._assigned.append(assignment)
        return assignment.task

    def _begin(self, begun: Any, observations: Any) -> None:
        for row, assignment in zip(np.flatnonzero(begun), self._assigned, strict=True):
            self._episodes[row] = EpisodeUnderWay(assignment, observations[row], self._link.gamma)
            self._trains[row] = assignment.trains


def restarted(worlds: AsyncVectorEnv, link: Link, apply: Apply | None) -> AsyncVectorEnv:
    """Restart the processes of `worlds` with environments that take tasks from a curriculum.

    Gymnasium cannot wrap environments in running processes. The arguments must be picklable.
    """
    settings = {name: getattr(worlds, name) for name in inspect.signature(AsyncVectorEnv).parameters}
    worlds.close()
    settings["env_fns"] = [partial(_made, make, link, apply) for make in worlds.env_fns]
    return AsyncVectorEnv(**settings)


def _made(make: Callable[[], Environment], link: Link, apply: Apply | None) -> CurriculumEnvironment:
    return CurriculumEnvironment(make(), link, apply)


def wrap_vector(
    worlds: VectorEnv[Any, Any, Any], link: Link, apply: Apply | None
) -> VectorEnv[Any, Any, Any]:
    """Wrap a vector environment to take tasks from a curriculum; see `Curriculum.wrap_vector`.

    Raises:
        TypeError: if the environments cannot be wrapped one by one.
    """
    if isinstance(worlds.unwrapped, VectorEnvironment) and apply is None:
        return CurriculumWorlds(worlds, link)
    if isinstance(worlds.unwrapped, SyncVectorEnv):
        inner = worlds.unwrapped
        inner.envs = [CurriculumEnvironment(environment, link, apply) for environment in inner.envs]
        return worlds
    raise TypeError(
        f"{worlds} cannot be wrapped: expected gymnasium.vector.SyncVectorEnv, AsyncVectorEnv before any "
        f"wrapper, or tma_ray's worlds; in other vector environments wrap each environment where it is made, "
        f"in other processes by curriculum.shared().wrap(environment)"
    )
