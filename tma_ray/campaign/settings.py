"""Settings of a campaign's execution, which do not affect results, and cluster addresses."""

import os
import re
import socket
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

PLENTY: Final = float(sys.maxsize)  # more memory than any run needs, in bytes

AUTOSCALING_QUEUE = 64
"""Largest number of queued runs on an autoscaling cluster; with fewer it would add nodes one by one."""

COHORT_WIDTH = CohortSettings.width  # default number of slots of a cohort on a GPU


class TeacherPlacement(StrEnum):
    """Process in which a run's teacher executes; it does not affect results."""

    ACTOR = "actor"
    """In a separate actor on the run's node."""
    INLINE = "inline"
    """In the run's process, for very short episodes."""


@dataclass(frozen=True)
class Resources:
    """Resources that one run occupies.

    Attributes:
        cpus: number of cores, and of torch's threads (at least 1).
        gpus: share of a GPU, or a whole number of GPUs.
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
        """Number of torch threads per run."""
        return max(1, int(self.cpus))

    def fit_into(self, node: Mapping[str, float]) -> int:
        """Return how many runs with these resources fit on `node` at once."""
        needed = {"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * GIB}
        return min(int(node.get(name, 0.0) / amount) for name, amount in needed.items() if amount > 0)


@dataclass(frozen=True)
class Nodes:
    """Nodes for which costs are estimated.

    Attributes:
        resources: Ray's resources of each node, with memory in bytes.
        where: phrase that names the nodes.
    """

    resources: tuple[Mapping[str, float], ...]
    where: str

    def at_once(self, run: Resources) -> int:
        """Return the number of runs that the nodes hold at once, at least one."""
        return max(1, sum(run.fit_into(node) for node in self.resources))


def this_machine() -> Nodes:
    """Return this machine as a single node, with its usable cores, one GPU and unlimited memory."""
    resources = {"CPU": float(usable_cores()), "GPU": 1.0, "memory": PLENTY}
    return Nodes((resources,), "as on this machine")


ROLLOUT_WORKER = Resources(cpus=0.25, memory_gib=0.5)
"""Default resources of a run in a cohort, whose networks and replay buffer are in the learner."""


@dataclass(frozen=True)
class ExecutionConfig:
    """Configuration of a campaign's execution: resources, device, checkpoints and fault tolerance.

    Attributes:
        resources: resources of one run that learns alone.
        device: torch's device of the networks.
        cohort: slots of each cohort; 0 if every run learns alone, with a share of a GPU on "cuda"; None for
            `COHORT_WIDTH` on "cuda" without GPU shares, else 0.
        rollout_worker: resources of one run in a cohort, without its learner.
        teachers: placement of teachers.
        checkpoint_seconds: longest time between two checkpoints of a run, s.
        most_losses: losses of a run after which it counts as failed.
        outage_seconds: longest outage of the results' storage before runs are lost and the campaign ends, s.
        unreachable_seconds: longest silence of a run or a learner before it counts as lost, s.
        grace_seconds: longest wait for checkpoints after a stop, s.
        poll_seconds: time between two polls of the runs, s.
        autoscaling: True if the cluster adds nodes for queued runs, also for those that fit no node yet.
    """

    resources: Resources = field(default_factory=Resources)
    device: str = Placement.device
    cohort: int | None = None
    rollout_worker: Resources = ROLLOUT_WORKER
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
        if self.width and (self.resources.gpus or self.rollout_worker.gpus):
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
        """Number of slots of each cohort; 0 if every run learns alone."""
        if self.cohort is not None:
            return self.cohort
        shared = self.device.partition(":")[0] == "cuda" and not self.resources.gpus
        return COHORT_WIDTH if shared else 0

    @property
    def per_run(self) -> Resources:
        """Resources of one run, alone or in a cohort."""
        return self.rollout_worker if self.width else self.resources

    @property
    def max_queued(self) -> int:
        """Number of runs to submit beyond the nodes' capacity, as demand for an autoscaler."""
        return AUTOSCALING_QUEUE if self.autoscaling else 1

    @property
    def placement(self) -> Placement:
        """Placement of a run, without the learner of a cohort."""
        device = Placement.device if self.width else self.device
        return Placement(device, self.per_run.threads, self.checkpoint_seconds, self.outage_seconds)


PROBE_SECONDS: Final = 5.0  # longest wait for a connection to an address, s

_HOST: Final = re.compile(r"[\w.-]+|[0-9a-fA-F:.]*:[0-9a-fA-F:.]+(%\w+)?")
"""Pattern of a host name or an IP address."""


def check_address(address: str) -> None:
    """Check that a campaign could join a cluster at this address.

    Args:
        address: "host:port" of a cluster's head, or "auto": RAY_ADDRESS if set, else the Ray on this
            machine, which Ray finds itself.

    Raises:
        ValueError: if the address is malformed.
        ConnectionError: if nothing listens there.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or "auto"
    head = host_and_port(address)
    if head is None:
        return
    try:
        socket.create_connection(head, timeout=PROBE_SECONDS).close()
    except OSError as error:
        raise ConnectionError(connection_advice(address, f"nothing listens there ({error})")) from error


def host_and_port(address: str) -> tuple[str, int] | None:
    """Return the host and port of a cluster's head, or None for "auto".

    Raises:
        ValueError: if the address is malformed.
    """
    if address == "auto":
        return None
    if "://" in address:
        raise ValueError(
            f"address {address!r} is for Ray's own tools, and no campaign can run through it: its driver "
            f"belongs on the cluster, where its address is 'auto'; get it there with "
            f"'ray job submit --address http://127.0.0.1:8265 -- python SCRIPT --address auto'"
        )
    host, separator, port = address.rpartition(":")
    host = host.strip("[]")
    if not (separator and _HOST.fullmatch(host) and port.isdecimal() and 0 < int(port) < 2**16):
        raise ValueError(
            f"address {address!r}: expected 'auto' or the head's 'host:port', as in 10.0.0.5:6379"
        )
    return host, int(port)


def connection_advice(address: str, reason: str) -> str:
    """Return a message about a failed connection to `address`, with its cause and remedies."""
    return (
        f"no Ray cluster was joined at {address!r}: {reason}. From one of its nodes use '--address auto'; "
        f"from elsewhere submit the campaign instead ('ray job submit', 'ray submit'). A cluster that asks "
        f"for a token needs RAY_AUTH_MODE=token and its own ~/.ray/auth_token (or RAY_AUTH_TOKEN_PATH). "
        f"'--local' needs no cluster"
    )
