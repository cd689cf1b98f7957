"""The challenges of the paper for simulated students, as data."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.tasks import TaskSpace, TestSet
from tma_ray.testing.students import Aptitude

ORIGINAL = find_challenge("stump_tracks", "original")
"""Stump Tracks' own space: height 0 to 3, spacing 0 to 6 (paper, appendix C)."""


@dataclass(frozen=True)
class SimulatedChallenge:
    """A setting for simulated students that isolates one difficulty for teachers.

    Attributes:
        name: what files and flags call it, as the paper's challenges are called in results.
        title: what tables call it.
        task_space: what the teacher may choose from.
        aptitudes: of the students, one run after the other: seed s trains the (s mod n)-th.
        resets: shares of the episodes after which the student forgets everything.
        rugged: whether the teacher works in a shuffled space.
        easy_task: the easiest task (d,), told at high expert knowledge.
        hard_task: the hardest task (d,) that could be feasible; what demands more is not.
        test_set: name of the tasks the student is tested on, which the world has, shuffled or not.
    """

    name: str
    title: str
    task_space: TaskSpace
    aptitudes: tuple[Aptitude, ...] = (Aptitude(),)
    resets: tuple[float, ...] = ()
    rugged: bool = False
    easy_task: tuple[float, ...] = (0, 6)
    hard_task: tuple[float, ...] = (3, 0)
    test_set: str = ORIGINAL.test_set

    def tests(self) -> TestSet:
        """Returns the test tasks."""
        return load_test_set(self.test_set)


SIMULATED_CHALLENGES: tuple[SimulatedChallenge, ...] = (
    SimulatedChallenge("original", "Original", ORIGINAL.task_space),
    SimulatedChallenge(
        "mostly_unfeasible", "Mostly unfeasible", ORIGINAL.task_space.with_bounds("stump_height", 0, 9)
    ),
    SimulatedChallenge(
        "mostly_trivial", "Mostly trivial", ORIGINAL.task_space.with_bounds("stump_height", -3, 3)
    ),
    SimulatedChallenge("forgetting_student", "Forgetting student", ORIGINAL.task_space, resets=(0.35, 0.7)),
    SimulatedChallenge("rugged_difficulty", "Rugged difficulty", ORIGINAL.task_space, rugged=True),
    SimulatedChallenge(
        "diverse_students",
        "Diverse students",
        ORIGINAL.task_space,
        aptitudes=tuple(Aptitude(pace=pace, limit=limit) for limit in (0.5, 0.7) for pace in (0.04, 0.08)),
    ),
)
"""As in the paper's appendix C: almost 80 % of the mostly unfeasible space cannot be learned, half of the
mostly trivial one is flat ground, the forgetting student starts anew at 7 and 14 of 20 million steps. Two
limits (its two bodies) with two paces (its two students) stand for the diverse students."""


def find_simulated_challenge(name: str) -> SimulatedChallenge:
    """Returns the simulated challenge called `name`.

    Raises:
        ValueError: there is none; the message holds the nearest match.
    """
    known = {challenge.name: challenge for challenge in SIMULATED_CHALLENGES}
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"no simulated challenge {name!r}: {hint}known: {', '.join(known)}")
    return known[name]
