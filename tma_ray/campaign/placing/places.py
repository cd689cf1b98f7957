"""Places at which runs can start, and those of runs that learn alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from tma_ray.campaign.cluster.connection import capacity
from tma_ray.campaign.cluster.head import Head
from tma_ray.campaign.settings import Settings
from tma_ray.results import LearnerProgress
from tma_ray.runs.placement import Placement
from tma_ray.runs.spec import RunSpec


@dataclass(frozen=True)
class Place:
    """Place of one run.

    Attributes:
        placement: settings of its execution.
        node: Ray's id of the node that it has to be on; empty: Ray chooses.
    """

    placement: Placement
    node: str = ""


class Places(Protocol):
    """Places of a campaign's runs."""

    def take(self, waiting: deque[RunSpec]) -> tuple[RunSpec, Place] | None:
        """Takes out of `waiting` a run that can start now; returns None if none can."""
        ...

    def leave(self, run_id: str) -> None:
        """Frees the place of a run that has ended, however it did."""
        ...

    def excuses(self, run_id: str) -> bool:
        """Tells, before it leaves, that a run was lost by no fault of its own and is to be repeated."""
        ...

    def look(self, *, over: bool) -> Sequence[LearnerProgress]:
        """Looks after the learners of cohorts, and returns how they are; `over`: no run is to come."""
        ...

    def close(self) -> None:
        """Ends all learners."""
        ...


class AnyNode:
    """Places of runs that learn alone: as many as the nodes hold, and some more.

    The more keep a demand in the queue that an autoscaler can see.

    Args:
        settings: of the campaign.
        head: of the Ray that this process is connected to.
    """

    def __init__(self, settings: Settings, head: Head) -> None:
        self._settings, self._head = settings, head
        self._taken: set[str] = set()

    def take(self, waiting: deque[RunSpec]) -> tuple[RunSpec, Place] | None:
        """Returns the first run, if there is room; see `Places`."""
        if not waiting:
            return None
        holds = capacity(self._settings.resources, self._head.nodes()) + self._settings.queued
        if len(self._taken) >= holds:
            return None
        spec = waiting.popleft()
        self._taken.add(spec.run_id)
        return spec, Place(self._settings.placement)

    def leave(self, run_id: str) -> None:
        """Frees a place; see `Places`."""
        self._taken.discard(run_id)

    def excuses(self, run_id: str) -> bool:  # noqa: ARG002  # of nobody
        """Returns False: every run has a process of its own."""
        return False

    def look(self, *, over: bool) -> Sequence[LearnerProgress]:  # noqa: ARG002
        """Returns an empty sequence: every run is its own learner."""
        return ()

    def close(self) -> None:
        """Does nothing: every run is its own learner."""
