"""Retry policy for runs whose process died: when, and away from which nodes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tma_ray.runs.spec import RunSpec

FIRST_PAUSE, LONGEST_PAUSE = 1.0, 300.0
"""Pause after a run's first loss, doubled with every other, and its bound, s."""


@dataclass
class _History:
    """Losses of a run: how many, and on which nodes."""

    losses: int = 0
    nodes: list[str] = field(default_factory=list)


class Retries:
    """Runs that wait for another attempt after a loss.

    Each loss of a run doubles the pause before its next attempt, so that what kills every attempt (too little
    memory, a broken mount) does not occupy the cluster.

    Args:
        most_losses: how often a run may be lost before it is given up.
        clock: current time, s.
    """

    def __init__(self, most_losses: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_losses = most_losses
        self._clock = clock
        self._histories: dict[str, _History] = {}
        self._pausing: list[tuple[float, RunSpec]] = []

    def __len__(self) -> int:
        return len(self._pausing)

    @property
    def specs(self) -> list[RunSpec]:
        """The runs that wait."""
        return [spec for _, spec in self._pausing]

    def add_loss(self, spec: RunSpec, node: str) -> bool:
        """Takes in a run that was lost on `node`, empty if unknown; returns False if it is given up."""
        history = self._histories.setdefault(spec.run_id, _History())
        history.losses += 1
        if node and node not in history.nodes:
            history.nodes.append(node)
        if history.losses > self._most_losses:
            return False
        pause = min(FIRST_PAUSE * 2 ** (history.losses - 1), LONGEST_PAUSE)
        self._pausing.append((self._clock() + pause, spec))
        return True

    def due(self) -> list[RunSpec]:
        """Returns the runs whose pause is over; they wait here no longer."""
        now = self._clock()
        due = [spec for at, spec in self._pausing if at <= now]
        self._pausing = [(at, spec) for at, spec in self._pausing if at > now]
        return due

    def losses(self, run_id: str) -> int:
        """Returns how often a run was lost."""
        return self._histories[run_id].losses if run_id in self._histories else 0

    def nodes_to_avoid(self, run_id: str) -> tuple[str, ...]:
        """Returns the nodes on which a run was lost."""
        return tuple(self._histories[run_id].nodes) if run_id in self._histories else ()
