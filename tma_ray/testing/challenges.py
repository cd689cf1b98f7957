"""The challenges of the paper for simulated students, as data."""

from __future__ import annotations

from dataclasses import dataclass

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.part_names import nearest
from tma_ray.tasks import TaskSpace, TestSet
from tma_ray.testing.students import StudentParameters


@dataclass(frozen=True)
class SimulatedChallenge:
    """A setting for simulated students that isolates one difficulty for teachers.

    Attributes:
        name: what files and flags call it, as the paper's challenges are called in results.
        title: what tables call it.
        task_space: what the teacher may choose from.
        aptitudes: of the students, one run after the other: seed s trains the (s mod n)-th.
        resets: shares of the episodes after which the student forgets everything.
        cuts: intervals per dimension that change places in the teacher's space, 0 for none.
        easy_task: the easiest task (d,), told at high expert knowledge.
        hard_task: the hardest task (d,) that could be feasible; what demands more is not.
        test_set: name of the tasks the student is tested on, which the world has, shuffled or not.
    """

    name: str
    title: str
    task_space: TaskSpace
    aptitudes: tuple[StudentParameters, ...] = (StudentParameters(),)
    resets: tuple[float, ...] = ()
    cuts: int = 0
    easy_task: tuple[float, ...] = (0, 6)
    hard_task: tuple[float, ...] = (3, 0)
    test_set: str = "stump_tracks"

    def tests(self) -> TestSet:
        """Returns the test tasks."""
        return load_test_set(self.test_set)


def _simulated(
    name: str, title: str, aptitudes: tuple[StudentParameters, ...] = (StudentParameters(),)
) -> SimulatedChallenge:
    """Returns the challenge of Stump Tracks called `name`, for students of these `aptitudes`."""
    real = find_challenge("stump_tracks", name)
    assert real.easy_task is not None, "Stump Tracks has an easy task"
    return SimulatedChallenge(
        name,
        title,
        real.task_space,
        aptitudes,
        resets=real.resets,
        cuts=real.cuts,
        easy_task=real.easy_task,
        test_set=real.test_set,
    )


SIMULATED_CHALLENGES: tuple[SimulatedChallenge, ...] = (
    _simulated("original", "Original"),
    _simulated("mostly_unfeasible", "Mostly unfeasible"),
    _simulated("mostly_trivial", "Mostly trivial"),
    _simulated("forgetting_student", "Forgetting student"),
    _simulated("rugged_difficulty", "Rugged difficulty"),
    _simulated(
        "diverse_students",
        "Diverse students",
        tuple(StudentParameters(pace=pace, limit=limit) for limit in (0.5, 0.7) for pace in (0.04, 0.08)),
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
        hint = nearest(name, known)
        raise ValueError(f"no simulated challenge {name!r}: {hint}known: {', '.join(known)}")
    return known[name]
