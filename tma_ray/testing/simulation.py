"""Training runs of simulated students with a teacher."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tma_ray.support.quantities import SEED
from tma_ray.support.validation import check_type
from tma_ray.tasks import (
    MASTERY_RETURN,
    Episode,
    KnowledgeLevel,
    Outcomes,
    ShuffledSpace,
    Task,
    check_task,
    expert_knowledge,
)
from tma_ray.teachers import TEACHERS, Teacher, effective_level, make_teacher
from tma_ray.testing.students import (
    DISCOUNTED_SHARE,
    EPISODE_STEPS,
    SimulatedChallenge,
    SimulatedStudent,
    report_episode,
)

EPISODES = 10_000  # default number of episodes of a run, equal to the paper's 20 million steps
EVALUATIONS = 20  # number of evenly spaced evaluations of a run, the last one at its end


@dataclass(frozen=True)
class SimulatedRun:
    """Outcome of a simulated run.

    Attributes:
        challenge: name of the simulated challenge.
        teacher: registered name, or ``module:Name``.
        level: effective level of expert knowledge.
        seed: seed of all randomness.
        returns: expected return on each test task after each twentieth of the episodes (20, n).
    """

    challenge: str
    teacher: str
    level: KnowledgeLevel
    seed: int
    returns: tuple[tuple[float, ...], ...]

    @property
    def curve(self) -> tuple[float, ...]:
        """Percentage of mastered test tasks after each twentieth of the episodes."""
        return tuple(100 * float(np.mean(np.array(row) > MASTERY_RETURN)) for row in self.returns)

    @property
    def mastered(self) -> float:
        """Percentage of mastered test tasks at the end."""
        return self.curve[-1]


class Simulation:
    """Training loop of a teacher and a simulated student.

    Student, shuffled space and random initial Gaussian depend only on the seed, equally for all teachers.

    Args:
        challenge: simulated challenge.
        teacher: registered name, or ``module:Name``.
        level: expert knowledge offered.
        seed: whole number of at least 0.
        hyperparameters: values that differ from the teacher's defaults.

    Raises:
        ValueError: if a teacher or hyper-parameter is unknown, or the knowledge does not suffice.

    Attributes:
        episodes: number of episodes so far, including evaluations for the teacher.
    """

    def __init__(
        self,
        challenge: SimulatedChallenge,
        teacher: str,
        level: KnowledgeLevel,
        seed: int,
        hyperparameters: Mapping[str, Any] | None = None,
    ) -> None:
        check_type("challenge", challenge, SimulatedChallenge, "what find_simulated_challenge returns")
        SEED.check("seed", seed)
        placement, teaching, learning = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(3))
        space, easy_task = challenge.task_space, challenge.easy_task
        self.landscape = ShuffledSpace.shuffle(space, placement, challenge.cuts) if challenge.cuts else None
        self.level = effective_level(TEACHERS.get(teacher), teacher, level)
        self.teacher: Teacher = make_teacher(teacher, hyperparameters)
        knowledge = expert_knowledge(self.level, space, placement, easy_task, landscape=self.landscape)
        self.teacher.start(space, knowledge, teaching)
        aptitude = challenge.aptitudes[seed % len(challenge.aptitudes)]
        self.student = SimulatedStudent(easy_task, challenge.hard_task, learning, aptitude)
        self.episodes = 0

    def advance(self) -> Episode:
        """Play one episode, report it to the teacher, and return it."""
        proposal = self.teacher.propose()
        task = check_task(proposal.task, self.teacher.space)
        world = self._world(task)
        observation = self.student.initial_observations(world)
        episodic_return = self.student.play(world, proposal.trains)
        self.episodes += 1
        episode = Episode(
            task=task,
            episodic_return=episodic_return,
            success=episodic_return > MASTERY_RETURN,
            length=EPISODE_STEPS,
            initial_observation=observation,
            discounted_return=DISCOUNTED_SHARE * episodic_return,
            step=EPISODE_STEPS * self.episodes,
            trains=proposal.trains,
        )
        report_episode(self.teacher, episode, self.student.state_values, self._outcomes)
        self.teacher.drain_updates()
        return episode

    def _world(self, task: Task) -> Task:
        return task if self.landscape is None else self.landscape.to_world(task)

    def _outcomes(self, tasks: Task, _greedy: bool) -> Outcomes:
        """Play one episode of each task without learning, count the episodes, and return the outcomes."""
        checked = [check_task(task, self.teacher.space) for task in tasks]
        played = np.array([self.student.play(self._world(task), trains=False) for task in checked])
        self.episodes += len(played)
        lengths = np.full(len(played), EPISODE_STEPS, dtype=np.int64)
        return Outcomes(played, played > MASTERY_RETURN, lengths)

    def evaluate(self, tests: Task) -> tuple[float, ...]:
        """Return the student's expected return on each of `tests` (n, d)."""
        return tuple(map(float, self.student.expected_returns(tests)))

    def mastered(self, tests: Task) -> float:
        """Return the percentage of `tests` (n, d) that the student masters."""
        return 100 * float(np.mean(np.array(self.evaluate(tests)) > MASTERY_RETURN))


def simulate(
    challenge: SimulatedChallenge,
    teacher: str,
    level: KnowledgeLevel = KnowledgeLevel.NONE,
    seed: int = 0,
    episodes: int = EPISODES,
    hyperparameters: Mapping[str, Any] | None = None,
) -> SimulatedRun:
    """Run a `Simulation` for a number of episodes, and return its outcome.

    Raises:
        ValueError: if there are fewer episodes than evaluations, or `Simulation` raises it.
    """
    if episodes < EVALUATIONS:
        raise ValueError(f"episodes = {episodes}: expected at least {EVALUATIONS}, one per evaluation")
    simulation = Simulation(challenge, teacher, level, seed, hyperparameters)
    tests = challenge.tests().tasks
    resets = sorted(round(share * episodes) for share in challenge.resets)
    returns: list[tuple[float, ...]] = []
    while simulation.episodes < episodes:
        simulation.advance()
        while (
            len(returns) < EVALUATIONS and simulation.episodes >= episodes * (len(returns) + 1) / EVALUATIONS
        ):
            returns.append(simulation.evaluate(tests))
        while resets and simulation.episodes >= resets[0]:
            simulation.student.reset()
            del resets[0]
    return SimulatedRun(challenge.name, teacher, simulation.level, seed, tuple(returns))
