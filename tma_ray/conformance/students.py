"""The contract of every student, as a test class that its author inherits."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces

from tma_ray.students import STUDENTS, Student, Transition, make_student

OBSERVATIONS = spaces.Box(-np.inf, np.inf, (3,), np.float32)
ACTIONS = spaces.Box(np.array([-2, -1], np.float32), np.array([1, 3], np.float32))
"""Of the trial world: oddly bounded, so that a student that takes them for [-1, 1] is noticed."""

EPISODE = 20
"""Steps of an episode of the trial world."""


class StudentConformance:
    """The contract of a student, as tests in a small world of noise.

    Inherit from it where pytest looks for tests, and name the student::

        class TestHillClimber(StudentConformance):
            student = "hill_climber:HillClimber"

    Every method is a promise; a failure says which, and what to do. pytest is needed to run the class, not to
    import it.

    Attributes:
        student: registered name, or ``module:Name``, with hyper-parameters if wanted.
        hyperparameters: to make it with, for instance smaller networks and buffers.
        steps: of training before it is looked at, in which it should have learned several times.
    """

    student: ClassVar[str]
    hyperparameters: ClassVar[Mapping[str, Any]] = {}
    steps: ClassVar[int] = 200

    def test_its_hyperparameters_have_defaults(self) -> None:
        """They can be left out, and the student is made without any."""
        kind = STUDENTS.get(self.student)
        if not isinstance(kind, type):
            return  # a factory checks them itself
        assert issubclass(kind, Student), f"{self.student} does not inherit from Student"
        kind.hyperparameters_type()

    def test_actions_are_inside_of_the_action_space(self) -> None:
        """Exploring and greedy ones, as float32 of the right shape."""
        student = self._made()
        for action in _train(student, self.steps, 0):
            assert action in ACTIONS, f"act gave {action!r}: expected float32 inside of {ACTIONS}"
        greedy = student.act_greedily(_states(5))
        assert greedy.shape == (5, *ACTIONS.shape), f"act_greedily of 5 gave shape {greedy.shape}"
        assert all(action.astype(np.float32) in ACTIONS for action in greedy), f"{greedy} leave {ACTIONS}"

    def test_the_same_seed_acts_the_same(self) -> None:
        """Bit for bit; another seed differs."""
        first, second, other = (_train(self._made(seed), self.steps, 0) for seed in (1, 1, 2))
        np.testing.assert_array_equal(
            first, second, "two students of one seed differ: is all randomness its own?"
        )
        assert (first != other).any(), "another seed makes no difference: is the seed used?"

    def test_a_loaded_state_goes_on_as_if_nothing_had_been(self) -> None:
        """Save at the end of an episode, load into a student of another seed: the same actions follow."""
        student, other = self._made(1), self._made(9)
        _train(student, self.steps, 0)
        _train(other, EPISODE, 3)
        with tempfile.TemporaryDirectory() as folder:
            student.save(Path(folder))
            other.load(Path(folder))
            expected, given = _train(student, self.steps, 1), _train(other, self.steps, 1)
        np.testing.assert_array_equal(
            expected, given, "after load it acts otherwise: what does save leave out?"
        )

    def test_asking_changes_nothing(self) -> None:
        """Greedy actions, values of states and actions without learning leave training as it would be."""
        asked, left_alone = self._made(1), self._made(1)
        for student in (asked, left_alone):
            _train(student, self.steps, 0)
        before = asked.act_greedily(_states(5))
        values = asked.state_values(_states(5))
        assert values.shape == (5,), f"state_values of 5 gave shape {values.shape}"
        assert np.isfinite(values).all(), f"state_values gave {values}"
        np.testing.assert_array_equal(
            before, asked.act_greedily(_states(5)), "act_greedily is not deterministic"
        )
        if type(asked).sample_actions is not Student.sample_actions:
            sampled, again = (asked.sample_actions(_states(5), np.random.default_rng(4)) for _ in range(2))
            assert all(action in ACTIONS for action in sampled), f"sample_actions gave {sampled!r}"
            np.testing.assert_array_equal(sampled, again, "sample_actions draws its noise elsewhere")
        np.testing.assert_array_equal(_train(asked, self.steps, 1), _train(left_alone, self.steps, 1))

    def test_its_policy_is_played_without_it(self) -> None:
        """A saved policy gives the greedy actions, and contains no pickle."""
        student = self._made()
        _train(student, self.steps, 0)
        with tempfile.TemporaryDirectory() as folder:
            student.save_policy(Path(folder))
            for file in Path(folder).rglob("*"):
                assert file.suffix not in (".pkl", ".pickle", ".pt", ".pth"), f"{file.name}: write no pickles"
            policy = type(student).load_policy(Path(folder))
            np.testing.assert_allclose(policy(_states(5)), student.act_greedily(_states(5)), atol=1e-5)

    def test_it_forgets(self) -> None:
        """After `reset` it acts and learns on, and does not act as it had learned to."""
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
    """Returns the actions of whole episodes of `steps` steps in a noisy linear world."""
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
