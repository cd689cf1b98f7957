"""The base of the benchmark's environments: one body in a world that a task describes."""

from abc import abstractmethod
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment, load_embodiment
from tma_ray.envs.scene import Look
from tma_ray.physics import (
    LIDARS,
    TIME_STEP,
    Engine,
    Rules,
    Signal,
    action_signals,
    make_engine,
    observation_signals,
    observation_size,
    step_arrays,
)
from tma_ray.tasks import MASTERY_RETURN, EpisodeSoFar, Task, TaskSpace, check_task
from tma_ray.terrain import Terrain

if TYPE_CHECKING:
    from tma_ray.envs.drawing import Renderer


MAX_EPISODE_STEPS = 2000
"""Steps after which an episode is truncated (the original release leaves this to its students)."""

PUSH = 5.0  # largest random push on the head in the first step, in N

NO_COPY = (
    "an environment in an episode cannot be copied or pickled, since the state of its world cannot: copy it "
    "before reset() or after the episode, or play the same seed, task and actions in another one"
)
"""Refusal of copies during an episode."""

Observation = NDArray[np.float32]


class BodyEnvironment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A body on its way through a world to a goal.

    An action is one value in [-1, 1] per motor, whose sign is the direction and whose size the share of the
    torque, then one per grip sensor: over 0 closes it. `reset` takes a task (``options={"task": [...]}``) or
    draws one uniformly from `task_space`. `info` holds "success" (an episodic return over 230) and the "task"
    (d,), at the end of an episode also "is_success", the same under the name that stable-baselines3 logs.
    Seed and actions determine a trajectory bit for bit. In an episode an environment can be neither copied
    nor pickled.

    A subclass says what its tasks are and builds their worlds.

    Args:
        embodiment: the body, its name or the path of its file.
        rules: the environment's rules for that body.
        render_mode: None, "rgb_array" or "human".

    Attributes:
        algorithm_version: part of the identity of every run: raised with each change of worlds, bodies,
            observations or rewards that the version of the physics does not cover.
        task_space: tasks that a teacher may choose; `reset` accepts more.
        valid_domain: tasks that `reset` accepts.
        max_episode_steps: steps after which an episode is truncated.
        embodiment: the body.
        rules: the environment's rules for the body.
        look: settings of frames; may be changed between two frames.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": round(1 / TIME_STEP)}
    algorithm_version: ClassVar[int | None] = None
    task_space: ClassVar[TaskSpace]
    valid_domain: ClassVar[TaskSpace]
    max_episode_steps = MAX_EPISODE_STEPS

    def __init__(self, embodiment: Embodiment, rules: Rules, render_mode: str | None) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r}: expected None, 'human' or 'rgb_array'")
        self.render_mode = render_mode
        self.embodiment, self.rules = embodiment, rules
        self.observation_space = _observation_space(observation_size(step_arrays(embodiment, rules)), rules)
        self.action_space = spaces.Box(-1.0, 1.0, (embodiment.action_size,), dtype=np.float32)
        self.look = Look()
        self._renderer: Renderer | None = None
        self._running = False

    @cached_property
    def _engine(self) -> Engine:
        """Engine, created on first use, so that reading the spaces compiles nothing."""
        return make_engine(self.embodiment, self.rules)

    @property
    def observation_signals(self) -> tuple[Signal, ...]:
        """The values of an observation, in order."""
        return observation_signals(self.embodiment, self.rules)

    @property
    def action_signals(self) -> tuple[Signal, ...]:
        """The values of an action, in order."""
        return action_signals(self.embodiment)

    @abstractmethod
    def build(self, task: Task, rng: np.random.Generator) -> Terrain:
        """Return the world of `task`; `rng` draws what the task leaves open."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Build the world of a task and return its first observation.

        Args:
            seed: number that makes this episode, and those after it, repeatable.
            options: {"task": one value per dimension of `valid_domain`, in order or by name}.

        Raises:
            ValueError: a task outside `valid_domain`, or an unknown option.
        """
        super().reset(seed=seed)
        task = self._chosen_task(options or {})
        push = self.np_random.uniform(-PUSH, PUSH)
        engine = self._engine  # before the world compiles anything: all kernels are known from then on
        self._terrain = self.build(task, self.np_random)
        observation = engine.reset(self._terrain, push)
        self._observation = observation
        self._task, self._episode, self._running = task, EpisodeSoFar(), True
        if self.render_mode == "human":
            self.render()
        return observation, {"success": False, "task": task.copy()}

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance the world by 1/50 s.

        Raises:
            ValueError: an action of another shape, or not finite.
            gymnasium.error.ResetNeeded: the episode has ended, or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded("the episode has ended or not begun; call reset()")
        observation, reward, terminated = self._engine.step(action)
        self._observation = observation
        self._episode.add(reward)
        truncated = not terminated and self._episode.steps >= self.max_episode_steps
        self._running = not (terminated or truncated)
        if self.render_mode == "human":
            self.render()
        success = self._episode.episodic_return > MASTERY_RETURN  # a `bool`, which Gymnasium can stack
        info = {"success": success, "task": self._task.copy()}
        if not self._running:
            info["is_success"] = success
        return observation, reward, terminated, truncated, info

    def release_engine(self) -> Engine:
        """Return the engine, to play the episode that has begun without this environment.

        The environment itself must be reset before its next step.

        Raises:
            gymnasium.error.ResetNeeded: the episode has ended, or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded("the episode has ended or not begun; call reset()")
        self._running = False
        return self._engine

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the world around the head: (400, 600, 3) for "rgb_array", a window for "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: make the environment with 'rgb_array'")
            return None
        from tma_ray.envs.drawing import Renderer  # here, so that training never loads pygame
        from tma_ray.envs.scene import scene_of

        if self._renderer is None:
            window = self.render_mode == "human"
            self._renderer = Renderer(self.embodiment, window, self.metadata["render_fps"])
        return self._renderer.draw(scene_of(self._engine, self._terrain, self._observation), self.look)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        if self._running:
            raise TypeError(NO_COPY)
        return {name: value for name, value in vars(self).items() if name != "_engine"} | {"_renderer": None}

    def _chosen_task(self, options: dict[str, Any]) -> Task:
        unknown = sorted(options.keys() - {"task"})
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; the only one is 'task'")
        if options.get("task") is None:
            return self.task_space.sample(self.np_random)
        return check_task(options["task"], self.valid_domain)


def embodiment_of(embodiment: str | Path | Embodiment) -> Embodiment:
    """Return a body by name or path, or the body itself."""
    return embodiment if isinstance(embodiment, Embodiment) else load_embodiment(embodiment)


def _observation_space(size: int, rules: Rules) -> spaces.Space[Observation]:
    """Return bounds that always hold; joints have none, since one that is hit hard overshoots its limits."""
    low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
    if rules.observes_medium:
        low[4:6], high[4:6] = 0.0, 1.0
        low[-2 * LIDARS : -LIDARS], high[-2 * LIDARS :] = 0.0, 1.0
        low[-LIDARS:] = -1.0
    else:
        low[-LIDARS:], high[-LIDARS:] = 0.0, 1.0
    return spaces.Box(low, high, dtype=np.float32)
