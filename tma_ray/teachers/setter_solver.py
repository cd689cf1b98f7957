"""Setter-Solver (Racaniere et al. 2020)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import Array, UnitBox

SMALLEST_FEASIBILITY = 1e-8


@dataclass(frozen=True, eq=False)
class Proposals:
    """Tasks proposed by the setter."""

    feasibility: Array  # requested feasibilities (n,)
    latents: Array  # Gaussian noise (n, f)
    points: Array  # tasks in the unit box (n, f)


@dataclass
class SetterSolver(Teacher):
    """Teacher whose setter network proposes tasks of requested feasibility, as predicted by a judge network.

    Both networks take one optimisation step every `update_every` episodes. The judge learns to predict
    successes. The setter learns to propose tasks with the requested feasibility according to the judge
    (feasibility), to assign a high likelihood to solved tasks (validity), and to maximise the entropy
    (coverage).

    Sources: Racaniere et al. 2020, section 3; paper, appendix A (Setter-Solver) and table of
    hyper-parameters; details from the original release, whose judge has two hidden layers instead of the
    paper's three, and whose validity loss is NaN without a success.

    The preset "release" has the values of the original release's launch files.

    Attributes:
        update_every: episodes between two updates (paper: n).
        noise: upper bound of the uniform noise of solved tasks in the validity loss, as a share of each
            range (paper: delta).
        hidden_units: units of each layer of the setter's networks (paper: n_HIDDEN).
        learning_rate: learning rate of Adam, for both networks.
    """

    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW,)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "release": {"update_every": 50, "noise": 0.1, "hidden_units": 64}
    }

    update_every: int = 100
    noise: float = 0.05
    hidden_units: int = 128
    learning_rate: float = 3e-4

    def __post_init__(self) -> None:
        check_at_least(self, 1, "update_every", "hidden_units")
        check_shares(self, "noise")
        check_positive(self, "learning_rate")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with untrained networks."""
        from tma_ray.teachers.networks import new_networks  # deferred: imports torch

        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        made = new_networks(self._box.size, self.hidden_units, self.learning_rate, rng)
        self.judge_, self.setter_, self.judge_optimiser_, self.setter_optimiser_ = made
        self._begin_batch()

    def sample(self) -> Task:
        """Return the next task (d,) in the batch."""
        task: Task = self._box.denormalise(self.batch_.points[len(self.successes_)])
        return task

    def observe(self, episode: Episode) -> None:
        """Record the outcome, and update both networks at the end of the batch."""
        self.successes_.append(episode.success)
        if len(self.successes_) == self.update_every:
            from tma_ray.teachers.networks import update_judge, update_setter

            batch, solved = self.batch_, np.array(self.successes_)
            judge_loss = update_judge(self.judge_, self.judge_optimiser_, batch.points, solved)
            targets = batch.points[solved]
            if solved.any():
                targets = targets + self.rng.uniform(0.0, self.noise, targets.shape)
            proposed = batch.latents, batch.feasibility
            losses = update_setter(
                self.setter_, self.judge_, self.setter_optimiser_, proposed, (targets, solved)
            )
            share = {"success_share": float(solved.mean()), "judge_loss": judge_loss}
            self.log(TeacherUpdate(scalars=share | losses))
            self._begin_batch()

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) from the setter, for uniform random feasibilities."""
        return self._box.denormalise(self._propose(count, self.probe_rng()).points)

    def _begin_batch(self) -> None:
        """Draw all tasks up to the next update."""
        self.batch_ = self._propose(self.update_every, self.rng)
        self.successes_: list[bool] = []

    def _propose(self, count: int, rng: np.random.Generator) -> Proposals:
        from tma_ray.teachers.networks import propose

        feasibility = rng.uniform(SMALLEST_FEASIBILITY, 1.0, count)
        latents = rng.standard_normal((count, self._box.size))
        return Proposals(feasibility, latents, propose(self.setter_, latents, feasibility))
