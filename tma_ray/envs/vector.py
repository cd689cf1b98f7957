"""Vector environments whose sub-environments, each with its own task, step in one compiled call."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import TimeLimit
from numpy.typing import ArrayLike, NDArray

from tma_ray.envs.base import NO_COPY
from tma_ray.envs.registration import Environment, make_environment, mastery_return
from tma_ray.physics import Engine, engine_in_use
from tma_ray.support.validation import check_whole
from tma_ray.tasks import Task, TaskSpace, task_values

if TYPE_CHECKING:
    from tma_ray.physics.compiled.engine import EngineBatch


class Outcome(NamedTuple):
    """Outcome of one step in k environments."""

    observations: NDArray[np.float32]  # (k, o)
    rewards: NDArray[np.float64]  # (k,)
    terminated: NDArray[np.bool_]  # (k,)
    truncated: NDArray[np.bool_]  # (k,), True at the time limit

    @property
    def over(self) -> NDArray[np.bool_]:
        """Mask (k,) of the episodes that have ended."""
        return self.terminated | self.truncated


@runtime_checkable
class EngineEnvironment(Protocol):
    """Interface of environments whose engine may be stepped directly."""

    max_episode_steps: int

    def release_engine(self) -> Engine:
        """End the environment's own episode, and return its engine, to be stepped by the caller."""
        ...


def lock_step(environments: Sequence[gymnasium.Env[Any, Any]], threads: int = 1) -> "LockStep":
    """Return the fastest `LockStep` for new `environments` of one class.

    Raises:
        ValueError: if there are more threads than environments, or several without the benchmark's engine.
    """
    check_whole("threads", threads, least=1)
    have_engines = all(isinstance(environment, EngineEnvironment) for environment in environments)
    most = len(environments) if have_engines else 1
    if threads > most:
        reason = "one for each world" if have_engines else "these worlds do not have the benchmark's engine"
        raise ValueError(f"threads = {threads}: expected at most {most}, {reason}")
    return EngineLockStep(environments, threads) if have_engines else LockStep(environments)


class LockStep:
    """Group of n environments of one class, stepped one after the other.

    Attributes:
        episodic_returns: sums of the rewards of the current episodes (n,).
    """

    def __init__(self, environments: Sequence[gymnasium.Env[Any, Any]]) -> None:
        self._environments = environments
        self.episodic_returns = np.zeros(len(environments))

    def read_limits(self) -> None:
        """Update the time limits of episodes from the environments."""

    def reset(
        self, rows: NDArray[np.int64], seeds: Sequence[int | None], tasks: Iterable[Task | None]
    ) -> tuple[NDArray[np.float32], Task]:
        """Reset the environments with indices `rows` (k,); the first call must reset all.

        Args:
            rows: indices of the environments (k,).
            seeds: seeds of their episodes (k,); None continues an environment's own stream.
            tasks: tasks of the episodes, each (d,); None draws one.

        Returns:
            Observations (k, o) and tasks (k, d), float32 as those of single worlds.
        """
        tasks = list(tasks)
        resets = [
            self._environments[row].reset(seed=seed, options=None if task is None else {"task": task})
            for row, seed, task in zip(rows, seeds, tasks, strict=True)
        ]
        observations = np.stack([observation for observation, _ in resets]).astype(np.float32, copy=False)
        played = [
            info["task"] if task is None else np.asarray(task, np.float32)
            for task, (_, info) in zip(tasks, resets, strict=True)
        ]
        self.episodic_returns[rows] = 0.0
        return observations, np.stack(played)

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Take one step with `actions` (k, a) in the environments with indices `rows` (k,)."""
        outcome = self._step(rows, actions)
        self.episodic_returns[rows] += outcome.rewards
        return outcome

    def _step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        steps = [self._environments[row].step(action) for row, action in zip(rows, actions, strict=True)]
        observations, rewards, terminated, truncated, _ = zip(*steps, strict=True)
        return Outcome(
            np.stack(observations).astype(np.float32, copy=False),
            np.array(rewards, dtype=np.float64),
            np.array(terminated, dtype=np.bool_),
            np.array(truncated, dtype=np.bool_),
        )


class EngineLockStep(LockStep):
    """Group of environments whose engines are stepped in one compiled call."""

    def __init__(self, environments: Sequence[gymnasium.Env[Any, Any]], threads: int = 1) -> None:
        super().__init__(environments)
        self._threads = threads
        self._batch: EngineBatch | None = None
        self._steps = np.zeros(len(environments), dtype=np.int64)
        self.read_limits()

    def read_limits(self) -> None:
        """Update the time limits of episodes; see `LockStep`."""
        self._longest = np.array([environment.max_episode_steps for environment in self._environments])  # type: ignore[attr-defined]

    def reset(
        self, rows: NDArray[np.int64], seeds: Sequence[int | None], tasks: Iterable[Task | None]
    ) -> tuple[NDArray[np.float32], Task]:
        """Reset the environments `rows`; see `LockStep`."""
        observations, played = super().reset(rows, seeds, tasks)
        choice = engine_in_use()
        if choice.name != "compiled":  # the environments step their own engines
            if self._threads > 1:
                raise ValueError(
                    f"threads = {self._threads}: expected 1 with the {choice.name} engine ({choice.reason})"
                )
            return observations, played
        from tma_ray.physics.compiled.engine import EngineBatch  # deferred: loads numba

        engines = [self._environments[row].release_engine() for row in rows]
        if self._batch is None:
            self._batch = EngineBatch(engines, self._threads)
        self._steps[rows] = 0
        return observations, played

    def _step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        if self._batch is None:
            return super()._step(rows, actions)
        observations, rewards, terminated = self._batch.step(rows, actions)
        self._steps[rows] = steps = self._steps[rows] + 1
        return Outcome(observations, rewards, terminated, ~terminated & (steps >= self._longest[rows]))


Observations: TypeAlias = NDArray[np.float32]
Flags: TypeAlias = NDArray[np.bool_]
NextTask: TypeAlias = Callable[[], ArrayLike | Mapping[str, float]]

OPTIONS = ("reset_mask", "task")  # keys of `options` in `reset`


class VectorEnvironment(VectorEnv[Observations, NDArray[np.float32], NDArray[Any]]):
    """Vector environment with the same results, bit for bit, as its sub-environments on their own.

    A sub-environment begins its next episode as Gymnasium specifies: in the next step, whose action
    is ignored (NEXT_STEP), in the same step, with the last observation and info under "final_obs" and
    "final_info" (SAME_STEP), or by `reset` with ``options["reset_mask"]`` (n,) (DISABLED). Its task comes
    from ``options["task"]`` (n, d), from `next_task`, or uniformly from `task_space`. `info` holds "success"
    (n,), a return over the mastery return, "task" (n, d) and, at the end of episodes, "is_success" (n,), each
    with its mask. A copy or a pickle, which is refused during episodes, has copies of the
    sub-environments, and must be reset before its first step, as after `close`.

    Args:
        environments: new environments of one class.
        threads: number of threads from the first reset until `close`, which does not change results. A
            forked process has one.
        autoreset_mode: mode or its value ("NextStep").
        next_task: function that returns the task of the next episode, (d,) or a dict of names, such as a
            teacher's `sample`; called in the order of the sub-environments.

    Raises:
        ValueError: if `environments` is empty, the mode is unknown, or there are too many threads.

    Attributes:
        next_task: function that returns the task of the next episode; may be replaced between two calls.

    Examples:
        >>> import tma_ray  # registers the environments
        >>> worlds = gymnasium.make_vec("tma_ray/StumpTracks-v0", num_envs=2, embodiment="spider")
        >>> observations, info = worlds.reset(seed=1, options={"task": np.array([[0.5, 3.0], [1.5, 6.0]])})
        >>> observations.shape, info["task"].tolist()
        ((2, 42), [[0.5, 3.0], [1.5, 6.0]])
    """

    def __init__(
        self,
        environments: Sequence[Environment],
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        next_task: NextTask | None = None,
    ) -> None:
        if not environments:
            raise ValueError("environments is empty: expected at least one")
        first = environments[0]
        self.num_envs = len(environments)
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self.next_task = next_task
        self._environments, self._worlds = environments, lock_step(environments, threads)
        self._threads = threads
        self._rows = np.arange(self.num_envs)
        self._everyone = np.ones(self.num_envs, np.bool_)
        self._running, self._ended = np.zeros((2, self.num_envs), np.bool_)
        self._tasks = np.zeros((self.num_envs, self.valid_domain.size), np.float32)
        self._observations: Observations | None = None
        self._read_mastery_returns()

    @property
    def task_space(self) -> TaskSpace:
        """Tasks that a teacher may choose; `reset` accepts more."""
        space: TaskSpace = self._environments[0].get_wrapper_attr("task_space")
        return space

    @property
    def valid_domain(self) -> TaskSpace:
        """Tasks that `reset` accepts."""
        domain: TaskSpace = self._environments[0].get_wrapper_attr("valid_domain")
        return domain

    @property
    def envs(self) -> tuple[Environment, ...]:
        """The n sub-environments, for reading attributes only, since their engines are stepped directly."""
        return tuple(self._environments)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Reset all sub-environments, or those selected by a mask.

        Args:
            seed: seeds of the sub-environments, or that of the first one, from which the others count up.
            options: {"task": (n, d) or a dict of names to (n,), "reset_mask": (n,) of bool}, both optional.

        Returns:
            Observations (n, o), in which the rows of other sub-environments are unchanged, and `info`.

        Raises:
            ValueError: if a task is outside `valid_domain`, a shape differs, or an option is unknown.
            gymnasium.error.ResetNeeded: if a mask leaves out a sub-environment that has never been reset.
        """
        options = options or {}
        unknown = sorted(options.keys() - set(OPTIONS))
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; known: {', '.join(OPTIONS)}")
        mask = self._mask(options.get("reset_mask"))
        seeds, tasks = self._seeds(seed), self._given_tasks(options.get("task"))
        observations = self._begin(mask, seeds, tasks)
        shown = np.where(mask[:, None], self._tasks, 0)
        success = {"success": np.zeros(self.num_envs, np.bool_), "_success": mask.copy()}
        return observations.copy(), {**success, "task": shown, "_task": mask.copy()}

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Step all sub-environments with `actions` (n, a), and reset those whose episodes have ended.

        None of them moves if an error is raised.

        Raises:
            ValueError: if actions have another shape or are not finite.
            gymnasium.error.ResetNeeded: if a sub-environment without an episode does not begin one by itself.
        """
        values = np.asarray(actions, dtype=np.float32)
        if values.shape != self.action_space.shape:
            raise ValueError(f"actions have shape {self.action_space.shape}, got {values.shape}")
        if np.count_nonzero(np.isfinite(values)) < values.size:  # several times as fast as `all`
            raise ValueError(f"actions must be finite, got {values[~np.isfinite(values).all(axis=1)][0]}")
        if np.count_nonzero(self._running) < self.num_envs:
            outcome, moved = self._step_after_ends(values)
        else:
            outcome, moved = self._worlds.step(self._rows, values), self._everyone
        observations, rewards, terminated, truncated = outcome
        success = (self._worlds.episodic_returns > self._mastery_returns) & moved
        assert self._observations is not None
        self._observations[:] = observations
        info = self._info(success, self._everyone)
        over = terminated | truncated
        if np.count_nonzero(over):
            self._running[over], self._ended[over] = False, True
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                info = self._begin_same_step(over, success)
                observations = self._observations.copy()
            else:
                info["is_success"], info["_is_success"] = success & over, over.copy()
        return observations, rewards, terminated, truncated, info

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return the value of an attribute of each sub-environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of all sub-environments.

        Args:
            name: name of the attribute, such as "max_episode_steps".
            values: a list or tuple of n values, or one value for all.

        Raises:
            ValueError: if there is another number of values.
        """
        several = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(several) != self.num_envs:
            raise ValueError(f"{len(several)} values of {name} for {self.num_envs} worlds: expected one each")
        for environment, value in zip(self._environments, several, strict=True):
            environment.set_wrapper_attr(name, value)
        self._worlds.read_limits()
        self._read_mastery_returns()

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return the results of a method of each sub-environment, or the values of an attribute."""
        attributes = [environment.get_wrapper_attr(name) for environment in self._environments]
        return tuple(value(*args, **kwargs) if callable(value) else value for value in attributes)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  (the signature of the base)
        """Close all sub-environments, and stop the threads."""
        for environment in self._environments:
            environment.close()
        self._worlds, self._observations = lock_step(self._environments, self._threads), None
        self._running[:], self._ended[:] = False, False

    def __reduce__(self) -> tuple[type["VectorEnvironment"], tuple[Any, ...], dict[str, Any]]:
        if self._running.any():
            raise TypeError(NO_COPY)
        arguments = self._environments, self._threads, self.autoreset_mode, self.next_task
        return VectorEnvironment, arguments, {"spec": self.spec}

    def _begin(self, mask: Flags, seeds: Sequence[int | None], tasks: Sequence[Task | None]) -> Observations:
        """Reset the sub-environments in `mask`, and return the observations of all, without copying."""
        chosen = self._rows[mask]
        self._running[chosen] = False  # remains False if a task is refused
        observations, played = self._worlds.reset(
            chosen, [seeds[row] for row in chosen], [self._chosen_task(tasks[row]) for row in chosen]
        )
        if self._observations is None:
            self._observations = np.empty((self.num_envs, observations.shape[1]), np.float32)
        self._observations[chosen], self._tasks[chosen] = observations, played
        self._running[chosen], self._ended[chosen] = True, False
        return self._observations

    def _step_after_ends(self, actions: NDArray[np.float32]) -> tuple[Outcome, Flags]:
        """Reset sub-environments whose episodes have ended, and step all other sub-environments.

        Returns:
            The outcome in all sub-environments, and a mask (n,) of those that were stepped.
        """
        moved, begun = self._running.copy(), self._ended.copy()
        if self.autoreset_mode is AutoresetMode.DISABLED or not (moved | begun).all():
            over = ", ".join(map(str, self._rows[~moved]))
            raise gymnasium.error.ResetNeeded(
                f"the episodes of worlds {over} have ended or not begun; call "
                f"reset(options={{'reset_mask': terminations | truncations}})"
            )
        nothing = [None] * self.num_envs
        observations = self._begin(begun, nothing, nothing).copy()
        rewards, (terminated, truncated) = np.zeros(self.num_envs), np.zeros((2, self.num_envs), np.bool_)
        if moved.any():
            outcome = self._worlds.step(self._rows[moved], actions[moved])
            observations[moved], rewards[moved] = outcome.observations, outcome.rewards
            terminated[moved], truncated[moved] = outcome.terminated, outcome.truncated
        return Outcome(observations, rewards, terminated, truncated), moved

    def _begin_same_step(self, over: Flags, success: Flags) -> dict[str, Any]:
        """Reset the sub-environments in the mask `over`, and return the `info` of the step."""
        assert self._observations is not None
        last = np.full(self.num_envs, None, dtype=object)
        for row in self._rows[over]:
            last[row] = self._observations[row].copy()
        ended = self._info(success & over, over)
        ended["task"][~over] = 0
        ended["is_success"], ended["_is_success"] = success & over, over.copy()
        nothing = [None] * self.num_envs
        self._begin(over, nothing, nothing)
        final = {"final_obs": last, "final_info": ended}
        masks = {"_final_obs": over.copy(), "_final_info": over.copy()}
        return {**final, **masks, **self._info(success & ~over, self._everyone)}

    def _info(self, success: Flags, mask: Flags) -> dict[str, Any]:
        return {"success": success, "_success": mask.copy(), "task": self._tasks.copy(), "_task": mask.copy()}

    def _read_mastery_returns(self) -> None:
        self._mastery_returns = np.array([mastery_return(environment) for environment in self._environments])

    def _mask(self, mask: Any) -> Flags:
        values = np.ones(self.num_envs, np.bool_) if mask is None else np.asarray(mask)
        if values.shape != (self.num_envs,) or values.dtype != np.bool_ or not values.any():
            raise ValueError(
                f"reset_mask has shape {values.shape} and type {values.dtype}: expected "
                f"({self.num_envs},) of bool, at least one of them true"
            )
        if self._observations is None and not values.all():
            raise gymnasium.error.ResetNeeded("the first reset begins an episode in every world")
        return values

    def _given_tasks(self, tasks: Any) -> list[Task | None]:
        if tasks is None:
            return [None] * self.num_envs
        values = task_values(tasks, self.valid_domain)
        expected = self.num_envs, self.valid_domain.size
        if values.shape != expected:
            raise ValueError(f"tasks have shape {expected}, one row for each world; got {values.shape}")
        return list(values)

    def _chosen_task(self, task: Task | None) -> Task | None:
        """Return `task` if given, else the result of `next_task`, or None for a random task."""
        if task is not None or self.next_task is None:
            return task
        return np.asarray(task_values(self.next_task(), self.valid_domain), np.float32)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None or isinstance(seed, int):
            return [None if seed is None else seed + row for row in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds for {self.num_envs} worlds: give one for each, or a number")
        return list(seed)


def make_vector_environment(
    name: str,
    num_envs: int = 1,
    threads: int = 1,
    *,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    next_task: NextTask | None = None,
    max_episode_steps: int | None = None,
    **kwargs: Any,
) -> VectorEnvironment:
    """Return a `VectorEnvironment` of `num_envs` sub-environments.

    Args:
        name: name of the environment, as for `make_environment`.
        num_envs: number of sub-environments.
        threads: number of threads that step them.
        autoreset_mode: mode of Gymnasium in which the next episode of a sub-environment begins.
        next_task: function that returns the task of the next episode.
        max_episode_steps: steps after which an episode is truncated; None for the environment's own number.
        kwargs: options of the environment, as for `make_environment`.

    Raises:
        UnknownNameError: if `name` is unknown.
        ValueError: if `num_envs`, `threads` or an option is invalid, a render mode is given, or
            episodes are longer than the environment's.
    """
    check_whole("num_envs", num_envs, least=1)
    if kwargs.get("render_mode") is not None:
        raise ValueError(
            f"render_mode = {kwargs['render_mode']!r}: worlds that are stepped together are not drawn; "
            f"make one with gymnasium.make, or with vectorization_mode='sync'"
        )
    environments = [make_environment(name, **kwargs) for _ in range(num_envs)]
    if max_episode_steps is not None:
        environments = [_shortened(environment, max_episode_steps) for environment in environments]
    return VectorEnvironment(environments, threads, autoreset_mode, next_task)


def _shortened(environment: Environment, steps: int) -> Environment:
    """Return `environment` with episodes limited to `steps`, which must not exceed its own limit."""
    check_whole("max_episode_steps", steps, least=1)
    if not isinstance(environment, EngineEnvironment):
        return TimeLimit(environment, steps)
    if steps > environment.max_episode_steps:
        raise ValueError(
            f"max_episode_steps = {steps}: expected at most {environment.max_episode_steps}, where the "
            f"environment itself truncates"
        )
    environment.max_episode_steps = steps
    return environment


# entry points for `gymnasium.make_vec`
stump_tracks = partial(make_vector_environment, "stump_tracks")
parkour = partial(make_vector_environment, "parkour")
