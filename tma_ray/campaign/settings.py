"""Settings of a campaign's execution, which do not change its results."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from tma_ray.runs.placement import Placement, check_device, usable_cores
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.support.quantities import CORES, GPUS, LOSSES, MEMORY, SECONDS, WIDTH
from tma_ray.support.validation import check_fields

GIB = 2**30

PLENTY: Final = float(sys.maxsize)  # memory that suffices for any run, in bytes

AUTOSCALING_QUEUE = 64
"""Runs that wait on an autoscaling cluster: with one only, nodes would come one after the other."""

COHORT_WIDTH = CohortSettings.width  # slots of a cohort on a GPU, unless another number is asked for


class TeacherPlacement(StrEnum):
    """Placement of teachers; results do not depend on it."""

    ACTOR = "actor"
    """In an actor of their own, on the node of their seed."""
    INLINE = "inline"
    """In their seed's process: for runs with very short episodes."""


@dataclass(frozen=True)
class Resources:
    """Resources that one run occupies.

    Attributes:
        cpus: cores; also the number of torch threads (at least 1).
        gpus: share of a GPU, or a whole number of them.
        memory_gib: memory in GiB; a SAC run with a full buffer of 2 million transitions takes about 1.
    """

    cpus: float = 1.0
    gpus: float = 0.0
    memory_gib: float = 1.5

    def __post_init__(self) -> None:
        CORES.check("cpus", self.cpus)
        GPUS.check("gpus", self.gpus)
        MEMORY.check("memory_gib", self.memory_gib)
        if self.gpus > 1 and self.gpus % 1:
            raise ValueError(
                f"gpus = {self.gpus:g}: expected a share of one GPU, as in 0.25, or a whole number"
            )

    @property
    def threads(self) -> int:
        """Torch's threads per run."""
        return max(1, int(self.cpus))

    def fit_into(self, node: Mapping[str, float]) -> int:
        """Return the number of runs that a node with these resources holds at once."""
        needed = {"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * GIB}
        return min(int(node.get(name, 0.0) / amount) for name, amount in needed.items() if amount > 0)


@dataclass(frozen=True)
class Nodes:
    """Nodes for which a cost is estimated: Ray's resources of each (memory in bytes), and a common name."""

    resources: tuple[Mapping[str, float], ...]
    place: str

    def at_once(self, each: Resources) -> int:
        """Return the number of runs that the nodes hold at once, at least one."""
        return max(1, sum(each.fit_into(node) for node in self.resources))


def this_machine() -> Nodes:
    """Return this machine with its usable cores, one GPU, and as much memory as needed."""
    own = {"CPU": float(usable_cores()), "GPU": 1.0, "memory": PLENTY}
    return Nodes((own,), "as on this machine")


PLAYER = Resources(cpus=0.25, memory_gib=0.5)
"""Resources of a run in a cohort, which mostly waits for updates and has neither networks nor replay."""


@dataclass(frozen=True)
class Settings:
    """Settings of a campaign's execution.

    Attributes:
        resources: resources of one run that learns alone.
        device: torch's name of where networks live.
        cohort: slots of each cohort, in which as many runs learn together; 0: every run learns alone, and
            occupies a share of a GPU exactly if `device` is "cuda"; None: `COHORT_WIDTH` on "cuda" where no
            run occupies a share of a GPU, else 0.
        player: resources of one run in a cohort, without its learner.
        teachers: placement of teachers.
        checkpoint_seconds: longest time between two checkpoints of a run, s.
        most_losses: number of processes that a run may lose before it counts as failed.
        outage_seconds: longest outage of the storage of the results before a run counts as lost, or the
            campaign ends, s.
        unreachable_seconds: longest silence of a run or a cohort's learner, not known to be dead, before it
            counts as lost, s.
        grace_seconds: longest wait for the checkpoints of a stop, s.
        poll_seconds: time between two looks at the runs, s.
        autoscaling: True if the cluster adds nodes for waiting runs: then runs are accepted that today's
            nodes cannot hold, and more of them wait.
    """

    resources: Resources = field(default_factory=Resources)
    device: str = Placement.device
    cohort: int | None = None
    player: Resources = PLAYER
    teachers: TeacherPlacement = TeacherPlacement.ACTOR
    checkpoint_seconds: float = Placement.checkpoint_seconds
    most_losses: int = 3
    outage_seconds: float = Placement.outage_seconds
    unreachable_seconds: float = 300.0
    grace_seconds: float = 60.0
    poll_seconds: float = 1.0
    autoscaling: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        check_device(self.device)
        if self.teachers not in list(TeacherPlacement):
            raise ValueError(f"teachers = {self.teachers!r}: expected {' or '.join(TeacherPlacement)}")
        LOSSES.check("most_losses", self.most_losses)
        for name in (name for name in vars(self) if name.endswith("_seconds")):
            SECONDS.check(name, getattr(self, name))
        if self.cohort is not None:
            WIDTH.check("cohort", self.cohort)
        kind = self.device.partition(":")[0]
        if self.width and kind not in ("cpu", "cuda"):
            raise ValueError(
                f"device = {self.device!r}: a cohort learns on 'cpu' or 'cuda'; add '--cohort off'"
            )
        if self.width and (self.resources.gpus or self.player.gpus):
            raise ValueError(
                "a run in a cohort occupies no GPU, its learner has one: leave out '--gpus-per-run', or add "
                "'--cohort off' for runs that learn alone"
            )
        if not self.width and self.resources.gpus and kind == "cpu":
            raise ValueError(
                f"device = 'cpu', but each run occupies {self.resources.gpus:g} GPUs: add '--device cuda', "
                f"or leave out '--gpus-per-run'"
            )
        if not self.width and kind == "cuda" and not self.resources.gpus:
            raise ValueError(
                f"device = {self.device!r}, but no GPU is reserved for a run: add '--gpus-per-run 0.25' for "
                f"four runs on each GPU, or 1 for one; without '--cohort off' they share one in a cohort"
            )

    @property
    def width(self) -> int:
        """Slots of each cohort; 0 if every run learns alone."""
        if self.cohort is not None:
            return self.cohort
        shared = self.device.partition(":")[0] == "cuda" and not self.resources.gpus
        return COHORT_WIDTH if shared else 0

    @property
    def each(self) -> Resources:
        """Resources of one run, wherever it learns."""
        return self.player if self.width else self.resources

    @property
    def queued(self) -> int:
        """Runs submitted beyond what the nodes hold: the demand that an autoscaler sees."""
        return AUTOSCALING_QUEUE if self.autoscaling else 1

    @property
    def placement(self) -> Placement:
        """Placement of a run, without the learner of a cohort."""
        device = Placement.device if self.width else self.device
        return Placement(device, self.each.threads, self.checkpoint_seconds, self.outage_seconds)
