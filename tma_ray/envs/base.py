"""Base class of the benchmark's environments, each with one body in a world generated from a task."""

from abc import abstractmethod
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment, load_embodiment
from tma_ray.envs.scene import RenderOptions, scene_of
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

MAX_EPISODE_STEPS = 2000  # longest episode, in steps (in the original release, students truncate episodes)
PUSH = 5.0  # largest random push on the head in the first step, in N

NOT_RUNNING = "the episode has ended or not begun; call reset()"
NO_COPY = (
    "an environment in an episode cannot be copied or pickled, since the state of its world cannot: copy it "
    "before reset() or after the episode, or play the same seed, task and actions in another one"
)
Observation = NDArray[np.float32]


class BodyEnvironment(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Base class of environments in which a body moves through a world to a goal.

    An action has one value in [-1, 1] per motor, whose sign is the direction and whose absolute value the
    share of the torque, then one per grip sensor, which closes it if positive. `reset` takes a task
    (``options={"task": [...]}``) or draws one uniformly from `task_space`. `info` holds "success" (an
    episodic return over 230), the "task" (d,) and, at the end of an episode, "is_success", the key that
    stable-baselines3 logs. Seed and actions determine a trajectory bit for bit. During an episode an
    environment can be neither copied nor pickled.

    A subclass declares its tasks and builds their worlds.

    Args:
        embodiment: body of the environment.
        rules: the environment's rules for the body.
        render_mode: None, "rgb_array" or "human".

    Attributes:
        algorithm_version: part of the identity of every run, increased with each change of worlds, bodies,
            observations or rewards that the version of the physics does not cover.
        task_space: tasks that a teacher may choose; `reset` accepts more.
        valid_domain: tasks that `reset` accepts.
        max_episode_steps: steps after which an episode is truncated.
        render_options: options of frames, which may change between two frames.
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
        self.render_options = RenderOptions()
        self._renderer: Renderer | None = None
        self._running = False

    @cached_property
    def _engine(self) -> Engine:
        """Engine, created on first use so that reading the spaces does not trigger compilation."""
        return make_engine(self.embodiment, self.rules)

    @property
    def observation_signals(self) -> tuple[Signal, ...]:
        """Signals of an observation, in order."""
        return observation_signals(self.embodiment, self.rules)

    @property
    def action_signals(self) -> tuple[Signal, ...]:
        """Signals of an action, in order."""
        return action_signals(self.embodiment)

    @abstractmethod
    def build(self, task: Task, rng: np.random.Generator) -> Terrain:
        """Return the terrain of `task`, with random details drawn from `rng`."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Build the world of a task, and return the first observation and the info.

        Args:
            seed: seed of this episode and those after it.
            options: {"task": one value per dimension of `valid_domain`, in order or by name}.

        Raises:
            ValueError: if the task is outside `valid_domain` or an option is unknown.
        """
        super().reset(seed=seed)
        task = self._chosen_task(options or {})
        push = self.np_random.uniform(-PUSH, PUSH)
        engine = self._engine  # before `build`: all kernels must be registered when the first is compiled
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
            ValueError: if the action has another shape or is not finite.
            gymnasium.error.ResetNeeded: if the episode has ended or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded(NOT_RUNNING)
        observation, reward, terminated = self._engine.step(action)
        self._observation = observation
        self._episode.add(reward)
        truncated = not terminated and self._episode.steps >= self.max_episode_steps
        self._running = not (terminated or truncated)
        if self.render_mode == "human":
            self.render()
        success = self._episode.episodic_return > MASTERY_RETURN
        info = {"success": success, "task": self._task.copy()}
        if not self._running:
            info["is_success"] = success
        return observation, reward, terminated, truncated, info

    def release_engine(self) -> Engine:
        """End the environment's own episode, and return its engine, to be stepped by the caller.

        Raises:
            gymnasium.error.ResetNeeded: if the episode has ended or not begun.
        """
        if not self._running:
            raise gymnasium.error.ResetNeeded(NOT_RUNNING)
        self._running = False
        return self._engine

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the world around the head as an array (400, 600, 3) or, for "human", in a window."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: make the environment with 'rgb_array'")
            return None
        from tma_ray.envs.drawing import Renderer  # deferred, so that training does not load pygame

        if self._renderer is None:
            window = self.render_mode == "human"
            self._renderer = Renderer(self.embodiment, window, self.metadata["render_fps"])
        scene = scene_of(self._engine, self._terrain, self._observation)
        return self._renderer.draw(scene, self.render_options)

    def close(self) -> None:
        """Close the window, if any."""
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
    """Return `embodiment`, loaded if it is a name or a path."""
    return embodiment if isinstance(embodiment, Embodiment) else load_embodiment(embodiment)


def _observation_space(size: int, rules: Rules) -> spaces.Space[Observation]:
    """Return the observation space, unbounded for joints, which may exceed their limits in collisions."""
    low, high = np.full(size, -np.inf, np.float32), np.full(size, np.inf, np.float32)
    if rules.observes_medium:
        low[4:6], high[4:6] = 0.0, 1.0
        low[-2 * LIDARS : -LIDARS], high[-2 * LIDARS :] = 0.0, 1.0
        low[-LIDARS:] = -1.0
    else:
        low[-LIDARS:], high[-LIDARS:] = 0.0, 1.0
    return spaces.Box(low, high, dtype=np.float32)
