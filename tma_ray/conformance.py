"""Conformance tests of teachers, students, environments and embodiments, as test classes to inherit from.

pytest is needed to run a class, not to import it.
"""

import random
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

from tma_ray.embodiments import load_embodiment
from tma_ray.envs import Environment, make_environment, mastery_return
from tma_ray.physics.rules import VELOCITY_X_SCALE, VELOCITY_Y_SCALE
from tma_ray.students import STUDENTS, Student, Transition, make_student
from tma_ray.tasks import Task, TaskSpace
from tma_ray.testing import TeacherConformance
from tma_ray.testing.conformance import global_state

STEPS = 200  # number of steps in a rollout with random actions
KEPT = 10  # number of observations kept to check that they do not change
FASTEST = 100.0  # largest plausible head speed in m/s; above it, joints tear the body apart


class BodyConformance:
    """Conformance tests of an embodiment.

    Inherit from it in a test module, and name the embodiment::

        class TestHopper(BodyConformance):
            body = "hopper.toml"

    Attributes:
        body: name of the embodiment or path of its file, optionally with parameters.
        environments: names of the environments to test it in.
    """

    body: ClassVar[str]
    environments: ClassVar[Sequence[str]] = ("stump_tracks", "parkour")

    def pytest_generate_tests(self, metafunc: Any) -> None:
        """Parametrise tests by environment (pytest hook)."""
        if "environment" in metafunc.fixturenames:
            metafunc.parametrize("environment", self.environments)

    def test_its_file_is_read(self) -> None:
        """Check that parts, joints and sensors are consistent and that masses are positive."""
        loaded = load_embodiment(self.body)
        for part in loaded.parts:
            assert part.mass > 0, f"a part has mass {part.mass}: check its shape and density"
        assert loaded.action_size > 0, "a body without motors and grips has nothing to learn"

    def test_actions_and_observations_have_meanings(self, environment: str) -> None:
        """Check that signals cover every value of observations and actions."""
        made = make_environment(environment, embodiment=self.body)
        for kind in ("observation", "action"):
            signals = made.get_wrapper_attr(f"{kind}_signals")
            size = getattr(made, f"{kind}_space").shape[0]
            assert sum(signal.size for signal in signals) == size, f"{kind}s have {size} values"

    def test_it_stays_together_under_random_actions(self, environment: str) -> None:
        """Check that observations stay finite and that joints do not tear the body apart."""
        for seed in range(3):
            for observation, speed in self._played(environment, seed):
                assert np.isfinite(observation).all(), f"{self.body}: an observation is not finite"
                assert speed < FASTEST, (
                    f"{self.body}: its head moves at {speed:.0f} m/s; check anchors, limits and overlaps"
                )

    def test_seed_and_actions_determine_its_way(self, environment: str) -> None:
        """Check that an episode repeated in a new environment is bit-identical."""
        first, second = (
            [observation.tobytes() for observation, _ in self._played(environment, 1)] for _ in range(2)
        )
        assert first == second, f"{self.body}: the same seed and actions lead elsewhere"

    def test_its_motors_move_it(self, environment: str) -> None:
        """Check that actions change observations."""
        still, moved = (
            np.stack([observation for observation, _ in self._played(environment, 0, scale)])
            for scale in (0.0, 1.0)
        )
        steps = min(len(still), len(moved))
        assert (still[:steps] != moved[:steps]).any(), f"{self.body}: its motors change nothing"

    def _played(self, environment: str, seed: int, scale: float = 1.0) -> list[tuple[Any, float]]:
        """Return (observation, head speed in m/s) for each step of a random episode on the central task."""
        made, rng = make_environment(environment, embodiment=self.body), np.random.default_rng(seed)
        task = made.get_wrapper_attr("task_space").centre
        observation, _ = made.reset(seed=seed, options={"task": task})
        seen, scales = [(observation, 0.0)], np.array([VELOCITY_X_SCALE, VELOCITY_Y_SCALE])
        for _ in range(STEPS):
            action = scale * rng.uniform(-1, 1, made.action_space.shape or ())
            observation, _, terminated, truncated, _ = made.step(action.astype(np.float32))
            seen.append((observation, float(np.abs(observation[2:4] / scales).max())))
            if terminated or truncated:
                break
        return seen


class EnvironmentConformance:
    """Conformance tests of an environment.

    Inherit from it in a test module, and name the environment::

        class TestSwingUp(EnvironmentConformance):
            environment = "swing_up:SwingUp"

    Attributes:
        environment: registered name, or ``module:Name``, optionally with options.
        options: further options for its constructor.
        longest_episode: steps after which every episode must be over.
    """

    environment: ClassVar[str]
    options: ClassVar[Mapping[str, Any]] = {}
    longest_episode: ClassVar[int] = 10_000

    def test_gymnasium_accepts_it(self) -> None:
        """Check spaces, types and seeding with Gymnasium's environment checker."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the checker warns about unbounded boxes, which are allowed
            check_env(gymnasium.Wrapper(self._made()).unwrapped, skip_render_check=True)

    def test_its_spaces_suit_students(self) -> None:
        """Check that observations and actions are one-dimensional boxes and that actions are bounded."""
        made = self._made()
        for kind in ("observation_space", "action_space"):
            space = getattr(made, kind)
            assert isinstance(space, gymnasium.spaces.Box), f"{kind} is {space}: expected a Box"
            assert len(space.shape) == 1, f"{kind} has shape {space.shape}: expected one dimension"
        assert _actions(made).is_bounded(), f"{made.action_space} must have bounds: students scale to them"

    def test_it_declares_its_tasks(self) -> None:
        """Check that the task space lies inside the valid domain and has the same dimension names."""
        space, domain = self._spaces()
        assert space.names == domain.names, f"task_space has {space.names}, valid_domain {domain.names}"
        for corner in (space.low, space.high):
            assert domain.contains(corner), f"{corner.tolist()} of task_space is outside of valid_domain"
        mastery_return(self._made())

    def test_it_builds_every_task_of_its_domain(self) -> None:
        """Check that `reset` builds tasks from the whole valid domain and returns them in `info`."""
        made, domain = self._made(), self._spaces()[1]
        tasks = [domain.low, domain.high, *domain.sample(np.random.default_rng(0), 5)]
        for task in tasks:
            observation, info = made.reset(seed=0, options={"task": task})
            assert observation in made.observation_space, f"task {task.tolist()}: {observation} is not in it"
            assert "task" in info, "info of reset must hold the task, under 'task'"
            np.testing.assert_array_equal(np.float32(info["task"]), np.float32(task))
            shared = np.shares_memory(np.asarray(info["task"]), task)
            assert not shared, "info['task'] is the array that reset was given: copy it"

    def test_tasks_outside_its_domain_are_refused(self) -> None:
        """Check that values outside the domain, and NaN, raise a ValueError that names the dimension."""
        made, domain = self._made(), self._spaces()[1]
        for index, name in enumerate(domain.names):
            for value in (domain.low[index] - domain.width[index], np.nan):
                task: Any = domain.centre.copy()
                task[index] = value
                error = _refusal(made, task)
                assert error is not None, f"{name} = {value} is outside of valid_domain and was not refused"
                assert name in error, f"the refusal of {name} = {value} does not name it: {error!r}"

    def test_without_a_task_it_draws_one(self) -> None:
        """Check that `reset` without a task samples one from the task space, determined by the seed."""
        made, space = self._made(), self._spaces()[0]
        drawn = [np.float32(made.reset(seed=seed)[1]["task"]) for seed in (1, 2, 1)]
        assert all(space.contains(task) for task in drawn), f"{drawn} are not all inside of task_space"
        np.testing.assert_array_equal(drawn[0], drawn[2], "the same seed must draw the same task")
        assert (drawn[0] != drawn[1]).any(), "another seed must draw another task"

    def test_seed_and_actions_determine_what_it_gives(self) -> None:
        """Check that episodes depend only on seed and actions, bit for bit."""
        made = self._made()
        first = self._play(made, 1)
        self._play(made, 2)
        random.seed(3)
        np.random.seed(3)  # noqa: NPY002 - must not matter
        assert self._play(made, 1) == first, "a seed gives another episode the second time"
        assert self._play(self._made(), 1) == first, "a new instance gives another episode"

    def test_what_it_returned_does_not_change_later(self) -> None:
        """Check that every observation is a new array, since students keep them."""
        made, rng = self._made(), np.random.default_rng(0)
        kept = [made.reset(seed=0)[0]]
        values = [kept[0].tobytes()]
        for step in range(1, KEPT):
            observation, _, terminated, truncated, _ = made.step(_action(made, rng))
            changed = any(
                np.shares_memory(observation, earlier) or earlier.tobytes() != before
                for earlier, before in zip(kept, values, strict=True)
            )
            assert not changed, f"step {step} changes an earlier observation: return a new array each time"
            kept.append(observation)
            values.append(observation.tobytes())
            if terminated or truncated:
                made.reset()

    def test_global_random_numbers_are_left_alone(self) -> None:
        """Check that all randomness comes from ``self.np_random``."""
        before = global_state()
        self._play(self._made(), 1)
        changed = [name for name, state in global_state().items() if state != before.get(name, state)]
        assert not changed, f"it changes the global state of {changed}; use self.np_random"

    def test_episodes_end(self) -> None:
        """Check that episodes terminate or are truncated, since runs add no time limit."""
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
        """Check that, under random actions, observations stay in their space and rewards are finite."""
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
        """Return observations, rewards and episode ends of a rollout with random actions."""
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


OBSERVATIONS = spaces.Box(-np.inf, np.inf, (3,), np.float32)
ACTIONS = spaces.Box(np.array([-2, -1], np.float32), np.array([1, 3], np.float32))
"""Action space of the test environment, with odd bounds to reveal students that assume [-1, 1]."""

EPISODE = 20  # length of the test environment's episodes, in steps


class StudentConformance:
    """Conformance tests of a student, run in a small noisy environment.

    Inherit from it in a test module, and name the student::

        class TestHillClimber(StudentConformance):
            student = "hill_climber:HillClimber"

    Attributes:
        student: registered name, or ``module:Name``, optionally with hyper-parameters.
        hyperparameters: hyper-parameters for the tests, for instance smaller networks and buffers.
        steps: number of training steps before the checks, enough for several updates.
    """

    student: ClassVar[str]
    hyperparameters: ClassVar[Mapping[str, Any]] = {}
    steps: ClassVar[int] = 200

    def test_its_hyperparameters_have_defaults(self) -> None:
        """Check that all hyper-parameters have defaults."""
        kind = STUDENTS.get(self.student)
        if not isinstance(kind, type):
            return  # a factory checks its hyper-parameters itself
        assert issubclass(kind, Student), f"{self.student} does not inherit from Student"
        kind.hyperparameters_type()

    def test_actions_are_inside_of_the_action_space(self) -> None:
        """Check that exploring and greedy actions lie in the action space."""
        student = self._made()
        for action in _train(student, self.steps, 0):
            assert action in ACTIONS, f"act gave {action!r}: expected float32 inside of {ACTIONS}"
        greedy = student.act_greedily(_states(5))
        assert greedy.shape == (5, *ACTIONS.shape), f"act_greedily of 5 gave shape {greedy.shape}"
        assert all(action.astype(np.float32) in ACTIONS for action in greedy), f"{greedy} leave {ACTIONS}"

    def test_the_same_seed_acts_the_same(self) -> None:
        """Check that equal seeds give bit-identical actions, and different seeds different ones."""
        first, second, other = (_train(self._made(seed), self.steps, 0) for seed in (1, 1, 2))
        np.testing.assert_array_equal(
            first, second, "two students of one seed differ: is all randomness its own?"
        )
        assert (first != other).any(), "another seed makes no difference: is the seed used?"

    def test_a_loaded_state_goes_on_as_if_nothing_had_been(self) -> None:
        """Check that a loaded student acts and learns like the saved one."""
        student, other = self._made(1), self._made(9)
        _train(student, self.steps, 0)
        _train(other, EPISODE, 3)
        with tempfile.TemporaryDirectory() as folder:
            student.save(Path(folder))
            other.load(Path(folder))
            expected, actual = _train(student, self.steps, 1), _train(other, self.steps, 1)
        np.testing.assert_array_equal(
            expected, actual, "after load it acts otherwise: what does save leave out?"
        )

    def test_asking_changes_nothing(self) -> None:
        """Check that greedy actions, state values and sampled actions do not affect training."""
        asked, left_alone = self._made(1), self._made(1)
        for student in (asked, left_alone):
            _train(student, self.steps, 0)
        before = asked.act_greedily(_states(5))
        values = asked.state_values(_states(5))
        assert values.shape == (5,), f"state_values of 5 gave shape {values.shape}"
        assert np.isfinite(values).all(), f"state_values gave {values}"
        bonuses = asked.entropy_bonuses(_states(5))
        assert bonuses.shape == (5,), f"entropy_bonuses of 5 gave shape {bonuses.shape}"
        np.testing.assert_array_equal(
            before, asked.act_greedily(_states(5)), "act_greedily is not deterministic"
        )
        if type(asked).sample_actions is not Student.sample_actions:
            sampled, again = (asked.sample_actions(_states(5), np.random.default_rng(4)) for _ in range(2))
            assert all(action in ACTIONS for action in sampled), f"sample_actions gave {sampled!r}"
            np.testing.assert_array_equal(sampled, again, "sample_actions draws its noise elsewhere")
        np.testing.assert_array_equal(_train(asked, self.steps, 1), _train(left_alone, self.steps, 1))

    def test_its_policy_is_played_without_it(self) -> None:
        """Check that a saved policy reproduces the greedy actions and contains no pickle."""
        student = self._made()
        _train(student, self.steps, 0)
        with tempfile.TemporaryDirectory() as folder:
            student.save_policy(Path(folder))
            for file in Path(folder).rglob("*"):
                assert file.suffix not in (".pkl", ".pickle", ".pt", ".pth"), f"{file.name}: write no pickles"
            policy = type(student).load_policy(Path(folder))
            np.testing.assert_allclose(policy(_states(5)), student.act_greedily(_states(5)), atol=1e-5)

    def test_it_forgets(self) -> None:
        """Check that the student still acts and learns after a reset."""
        student = self._made()
        _train(student, self.steps, 0)
        student.reset()
        assert all(action in ACTIONS for action in _train(student, self.steps, 1))

    def _made(self, seed: int = 0) -> Student:
        values = dict(self.hyperparameters)
        return make_student(self.student, OBSERVATIONS, ACTIONS, np.random.SeedSequence(seed), values)


def _states(number: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.random.default_rng(5).normal(size=(number, 3)).astype(np.float32)


def _train(student: Student, steps: int, seed: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Train for `steps` steps in a noisy linear environment, and return the actions."""
    rng, actions = np.random.default_rng(seed), []
    state = rng.normal(size=3)
    for step in range(1, steps + 1):
        action = student.act(state.astype(np.float32))
        following = 0.9 * state + 0.3 * rng.normal(size=3) + 0.1 * float(np.sum(action))
        truncated = step % EPISODE == 0
        reward = 3.0 - float(state @ state)
        observed = state.astype(np.float32), action, reward, following.astype(np.float32), False, truncated
        student.observe(Transition(*observed))
        actions.append(np.array(action))
        state = rng.normal(size=3) if truncated else following
    return np.array(actions)


__all__ = ["BodyConformance", "EnvironmentConformance", "StudentConformance", "TeacherConformance"]
