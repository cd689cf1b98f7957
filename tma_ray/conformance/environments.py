"""The contract of every environment, as a test class that its author inherits."""

from __future__ import annotations

import random
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from tma_ray.envs import Environment, make_environment, mastery_return
from tma_ray.tasks import Task, TaskSpace

STEPS = 200
"""Random steps of a play."""


class EnvironmentConformance:
    """The contract of an environment, as tests.

    Inherit from it where pytest looks for tests, and name the environment::

        class TestSwingUp(EnvironmentConformance):
            environment = "swing_up:SwingUp"

    Every method is a promise; a failure says which, and what to do. pytest is needed to run the class, not to
    import it.

    Attributes:
        environment: registered name, or ``module:Name``, with options if wanted.
        options: further options of its constructor.
        longest_episode: steps after which every episode must be over.
    """

    environment: ClassVar[str]
    options: ClassVar[Mapping[str, Any]] = {}
    longest_episode: ClassVar[int] = 10_000

    def test_gymnasium_accepts_it(self) -> None:
        """Its spaces, types and seeds are what Gymnasium expects."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # advice on bounds, which observations need not have
            check_env(gymnasium.Wrapper(self._made()).unwrapped, skip_render_check=True)

    def test_its_spaces_suit_students(self) -> None:
        """Observations and actions are one-dimensional boxes, and actions have bounds."""
        made = self._made()
        for kind in ("observation_space", "action_space"):
            space = getattr(made, kind)
            assert isinstance(space, gymnasium.spaces.Box), f"{kind} is {space}: expected a Box"
            assert len(space.shape) == 1, f"{kind} has shape {space.shape}: expected one dimension"
        assert _actions(made).is_bounded(), f"{made.action_space} must have bounds: students scale to them"

    def test_it_declares_its_tasks(self) -> None:
        """The task space lies inside the valid domain, with the same names, and both are of any instance."""
        space, domain = self._spaces()
        assert space.names == domain.names, f"task_space has {space.names}, valid_domain {domain.names}"
        for corner in (space.low, space.high):
            assert domain.contains(corner), f"{corner.tolist()} of task_space is outside of valid_domain"
        mastery_return(self._made())

    def test_it_builds_every_task_of_its_domain(self) -> None:
        """`reset` takes corners and random tasks of the valid domain; `info` says which it built."""
        made, domain = self._made(), self._spaces()[1]
        tasks = [domain.low, domain.high, *domain.sample(np.random.default_rng(0), 5)]
        for task in tasks:
            observation, info = made.reset(seed=0, options={"task": task})
            assert observation in made.observation_space, f"task {task.tolist()}: {observation} is not in it"
            assert "task" in info, "info of reset must hold the task, under 'task'"
            np.testing.assert_array_equal(np.float32(info["task"]), np.float32(task))

    def test_tasks_outside_its_domain_are_refused(self) -> None:
        """A ValueError that names the dimension; also for NaN."""
        made, domain = self._made(), self._spaces()[1]
        for index, name in enumerate(domain.names):
            for value in (domain.low[index] - domain.width[index], np.nan):
                task: Any = domain.centre.copy()
                task[index] = value
                error = _refusal(made, task)
                assert error is not None, f"{name} = {value} is outside of valid_domain and was not refused"
                assert name in error, f"the refusal of {name} = {value} does not name it: {error!r}"

    def test_without_a_task_it_draws_one(self) -> None:
        """From the task space, by its seed."""
        made, space = self._made(), self._spaces()[0]
        drawn = [np.float32(made.reset(seed=seed)[1]["task"]) for seed in (1, 2, 1)]
        assert all(space.contains(task) for task in drawn), f"{drawn} are not all inside of task_space"
        np.testing.assert_array_equal(drawn[0], drawn[2], "the same seed must draw the same task")
        assert (drawn[0] != drawn[1]).any(), "another seed must draw another task"

    def test_seed_and_actions_determine_what_it_gives(self) -> None:
        """Bit for bit, whatever was played before and whatever others do with global random numbers."""
        made = self._made()
        first = self._play(made, 1)
        self._play(made, 2)
        random.seed(3)
        np.random.seed(3)  # noqa: NPY002  (what an environment must not depend on)
        assert self._play(made, 1) == first, "a seed gives another episode the second time"
        assert self._play(self._made(), 1) == first, "a new instance gives another episode"

    def test_global_random_numbers_are_left_alone(self) -> None:
        """All randomness comes from `self.np_random`."""
        before = random.getstate(), np.random.get_state()[1].tobytes()  # type: ignore[index]  # noqa: NPY002
        self._play(self._made(), 1)
        after = random.getstate(), np.random.get_state()[1].tobytes()  # type: ignore[index]  # noqa: NPY002
        assert before == after, "it draws from a global generator; use self.np_random"

    def test_episodes_end(self) -> None:
        """By themselves or truncated: a run adds no time limit."""
        made = self._made()
        made.reset(seed=0, options={"task": self._spaces()[0].centre})
        space = _actions(made)
        action = np.zeros(space.shape, np.float32).clip(space.low, space.high)
        for _ in range(self.longest_episode):
            *_, terminated, truncated, _ = made.step(action)
            if terminated or truncated:
                return
        raise AssertionError(f"an episode goes on after {self.longest_episode} steps; truncate it")

    def test_values_are_finite_and_in_their_spaces(self) -> None:
        """Observations of a random player are in the observation space, rewards finite numbers."""
        made, rng = self._made(), np.random.default_rng(0)
        made.reset(seed=0)
        for _ in range(STEPS):
            observation, reward, terminated, truncated, _ = made.step(_action(made, rng))
            assert observation in made.observation_space, f"{observation} is not in {made.observation_space}"
            assert np.isfinite(observation).all(), f"an observation is not finite: {observation}"
            assert np.isfinite(float(reward)), f"a reward is not finite: {reward}"
            if terminated or truncated:
                made.reset()

    def _made(self) -> Environment:
        return make_environment(self.environment, **self.options)

    def _spaces(self) -> tuple[TaskSpace, TaskSpace]:
        made = self._made()
        return made.get_wrapper_attr("task_space"), made.get_wrapper_attr("valid_domain")

    def _play(self, made: Environment, seed: int) -> list[bytes]:
        """Returns all that a random player gets to see."""
        rng = np.random.default_rng(seed)
        seen = [made.reset(seed=seed)[0].tobytes()]
        for _ in range(STEPS):
            observation, reward, terminated, truncated, _ = made.step(_action(made, rng))
            seen += [observation.tobytes(), np.float64(reward).tobytes(), bytes([terminated, truncated])]
            if terminated or truncated:
                seen.append(made.reset()[0].tobytes())
        return seen


def _actions(made: Environment) -> gymnasium.spaces.Box:
    space = made.action_space
    assert isinstance(space, gymnasium.spaces.Box), f"action_space is {space}: expected a Box"
    return space


def _action(made: Environment, rng: np.random.Generator) -> Any:
    space = _actions(made)
    return np.asarray(rng.uniform(space.low, space.high)).astype(space.dtype)


def _refusal(made: Environment, task: Task) -> str | None:
    try:
        made.reset(seed=0, options={"task": task})
    except ValueError as error:
        return str(error)
    return None
