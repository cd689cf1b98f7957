"""One training run of a simulated student under a teacher."""

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

EPISODES = 10_000
"""Default length of a run: the paper's 20 million steps."""

POINTS = 20  # evaluations of a run, evenly spaced, the last at its end


@dataclass(frozen=True)
class SimulatedRun:
    """Outcome of one simulated run.

    Attributes:
        challenge: name of the simulated challenge.
        teacher: registered name, or ``module:Name``.
        level: effective level of expert knowledge.
        seed: seed of teacher, student, and everything placed at random.
        returns: expected return on each test task after each twentieth of the episodes (20, n).
    """

    challenge: str
    teacher: str
    level: KnowledgeLevel
    seed: int
    returns: tuple[tuple[float, ...], ...]

    @property
    def curve(self) -> tuple[float, ...]:
        """Mastered share of the test tasks in per cent after each twentieth of the episodes."""
        return tuple(100 * float(np.mean(np.array(row) > MASTERY_RETURN)) for row in self.returns)

    @property
    def mastered(self) -> float:
        """Share of the test tasks mastered at the end, in per cent."""
        return self.curve[-1]


class Simulation:
    """Loop of a teacher and a simulated student.

    Attributes:
        episodes: played so far, those of evaluations for the teacher among them.

    Seeds are spawned in a fixed order: a shuffled space and the randomly placed initial Gaussian depend
    on the seed alone, so that all teachers meet the same, and the same student.

    Args:
        challenge: simulated challenge.
        teacher: registered name, or ``module:Name``.
        level: expert knowledge offered; the teacher is told what it uses of it.
        seed: whole number of at least 0.
        hyperparameters: values that differ from the teacher's defaults.

    Raises:
        ValueError: an unknown teacher or hyper-parameter, or too little knowledge for the teacher.
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
        """Play one episode, tell the teacher, and return it."""
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
        """Return the outcomes of an evaluation, whose episodes count; both policies are one."""
        checked = [check_task(task, self.teacher.space) for task in tasks]
        played = np.array([self.student.play(self._world(task), trains=False) for task in checked])
        self.episodes += len(played)
        lengths = np.full(len(played), EPISODE_STEPS, dtype=np.int64)
        return Outcomes(played, played > MASTERY_RETURN, lengths)

    def evaluate(self, tests: Task) -> tuple[float, ...]:
        """Return the student's expected return on each of `tests` (n, d)."""
        return tuple(map(float, self.student.expected_returns(tests)))

    def mastered(self, tests: Task) -> float:
        """Return the share of `tests` (n, d) that the student masters, in per cent."""
        return 100 * float(np.mean(np.array(self.evaluate(tests)) > MASTERY_RETURN))


def simulate(
    challenge: SimulatedChallenge,
    teacher: str,
    level: KnowledgeLevel = KnowledgeLevel.NONE,
    seed: int = 0,
    episodes: int = EPISODES,
    hyperparameters: Mapping[str, Any] | None = None,
) -> SimulatedRun:
    """Return the run of `episodes` episodes that `Simulation` describes.

    Args:
        challenge: simulated challenge.
        teacher: registered name, or ``module:Name``.
        level: expert knowledge offered; the teacher is told what it uses of it.
        seed: whole number of at least 0.
        episodes: length of the run.
        hyperparameters: values that differ from the teacher's defaults.

    Raises:
        ValueError: fewer episodes than evaluations, or what `Simulation` refuses.
    """
    if episodes < POINTS:
        raise ValueError(f"episodes = {episodes}: expected at least {POINTS}, one per evaluation")
    simulation = Simulation(challenge, teacher, level, seed, hyperparameters)
    tests = challenge.tests().tasks
    resets = sorted(round(share * episodes) for share in challenge.resets)
    returns: list[tuple[float, ...]] = []
    while simulation.episodes < episodes:
        simulation.advance()
        while len(returns) < POINTS and simulation.episodes >= episodes * (len(returns) + 1) / POINTS:
            returns.append(simulation.evaluate(tests))
        while resets and simulation.episodes >= resets[0]:
            simulation.student.reset()
            del resets[0]
    return SimulatedRun(challenge.name, teacher, simulation.level, seed, tuple(returns))
