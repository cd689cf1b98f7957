"""Setter-Solver (Racaniere et al. 2020)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics.networks import descend, inference, linear, torch_generator, training
from tma_ray.teachers.numerics.real_nvp import DTYPE, RealNVP
from tma_ray.teachers.numerics.unit_box import UnitBox

JUDGE_UNITS = 64
SMALLEST_FEASIBILITY = 1e-8


@dataclass(frozen=True, eq=False)
class Proposals:
    """Tasks as the setter drew them, n of them.

    Attributes:
        feasibility: asked for (n,).
        latents: Gaussian noise (n, f) that they were made from.
        points: in the unit box (n, f).
    """

    feasibility: NDArray[np.float64]
    latents: NDArray[np.float64]
    points: NDArray[np.float64]


@dataclass
class SetterSolver(Teacher):
    """A setter proposes tasks of a feasibility asked for; a judge learns how feasible tasks are.

    After every `update_every` episodes each network takes one step on them: the judge learns to tell
    successes; the setter learns to propose tasks that the judge finds as feasible as asked
    (feasibility), to find likely what the student solved (validity), and to spread (coverage).

    Sources: Racaniere et al. 2020, section 3; paper, appendix A (Setter-Solver) and table of
    hyper-parameters; what both leave open from the original release. Its judge has two hidden
    layers where the paper says three, and its validity loss is not a number without a success.

    The preset "release" has the values of the original release's launch files where they differ from the
    paper's table.

    Attributes:
        update_every: episodes between two updates (paper: n).
        noise: upper bound of the uniform noise added to solved tasks in the validity loss, as a share
            of each range (paper: delta).
        hidden_units: of each layer of the setter's networks (paper: n_HIDDEN).
        learning_rate: of Adam, for both networks.
    """

    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW,)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "release": {"update_every": 50, "noise": 0.1, "hidden_units": 64}
    }

    update_every: int = 100
    noise: float = 0.05
    hidden_units: int = 128
    learning_rate: float = 3e-4

    def __post_init__(self) -> None:
        for name in ("update_every", "hidden_units"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: expected at least 1")
        if not 0 <= self.noise <= 1:
            raise ValueError(f"noise = {self.noise} is a share of the range; expected a number in [0, 1]")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate = {self.learning_rate}: expected a number over 0")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Starts with networks that have learned nothing."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        seeded = torch_generator(rng)
        self.judge_ = _judge(self._box.size, seeded)
        self.setter_ = RealNVP(self._box.size, self.hidden_units, seeded)
        self.judge_optimiser_ = torch.optim.Adam(self.judge_.parameters(), self.learning_rate)
        self.setter_optimiser_ = torch.optim.Adam(self.setter_.parameters(), self.learning_rate)
        self._begin_batch()

    def sample(self) -> Task:
        """Returns the next task (d,) of the batch."""
        task: Task = self._box.denormalise(self.batch_.points[len(self.successes_)])
        return task

    def observe(self, episode: Episode) -> None:
        """Stores the success, and updates both networks at the end of the batch."""
        self.successes_.append(episode.success)
        if len(self.successes_) == self.update_every:
            self._update(np.array(self.successes_))
            self._begin_batch()

    def probe(self, count: int) -> Task:
        """Returns `count` tasks (count, d) of the setter, of uniform feasibility."""
        return self._box.denormalise(self._propose(count, self.probe_rng()).points)

    def _begin_batch(self) -> None:
        """Draws all tasks until the next update, since the setter does not change before."""
        self.batch_ = self._propose(self.update_every, self.rng)
        self.successes_: list[bool] = []

    def _propose(self, count: int, rng: np.random.Generator) -> Proposals:
        feasibility = rng.uniform(SMALLEST_FEASIBILITY, 1.0, count)
        latents = rng.standard_normal((count, self._box.size))
        with inference():
            points, _ = self.setter_(torch.from_numpy(latents), torch.from_numpy(feasibility))
        return Proposals(feasibility, latents, points.numpy())

    def _update(self, solved: NDArray[np.bool_]) -> None:
        with training():
            scalars = self._update_judge(solved) | self._update_setter(solved)
        self.log(TeacherUpdate(scalars={"success_share": float(solved.mean()), **scalars}))

    def _update_judge(self, solved: NDArray[np.bool_]) -> dict[str, float]:
        logits = self.judge_(torch.from_numpy(self.batch_.points))[:, 0]
        successes = torch.from_numpy(solved).to(DTYPE)
        loss = nn.functional.binary_cross_entropy_with_logits(logits, successes)
        descend(self.judge_optimiser_, loss)
        return {"judge_loss": loss.item()}

    def _update_setter(self, solved: NDArray[np.bool_]) -> dict[str, float]:
        wanted = torch.from_numpy(self.batch_.feasibility)
        points, log_density = self.setter_(torch.from_numpy(self.batch_.latents), wanted)
        judged = self.judge_(points)[:, 0]
        losses = {
            "feasibility_loss": ((judged - torch.logit(wanted)) ** 2).mean(),
            "coverage_loss": log_density.mean(),
        }
        if solved.any():
            noise = self.rng.uniform(0.0, self.noise, self.batch_.points[solved].shape)
            targets = torch.from_numpy(self.batch_.points[solved] + noise)
            _, likelihood = self.setter_.inverse(targets, wanted[torch.from_numpy(solved)])
            losses["validity_loss"] = -likelihood.mean()
        descend(self.setter_optimiser_, torch.stack(list(losses.values())).sum())
        return {name: loss.item() for name, loss in losses.items()}


def _judge(size: int, generator: torch.Generator) -> nn.Sequential:
    """Returns three hidden layers (paper, appendix A) and the logit of success."""
    widths = [size, JUDGE_UNITS, JUDGE_UNITS, JUDGE_UNITS]
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [linear(inputs, outputs, DTYPE, generator), nn.ReLU()]
    return nn.Sequential(*layers, linear(JUDGE_UNITS, 1, DTYPE, generator))
