"""The placement and the status of a run: no part of what it computes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Placement:
    """Placement of a run, which does not change what it computes.

    Attributes:
        device: torch's name of where networks live.
        threads: torch's threads of the run.
        checkpoint_seconds: longest time between two checkpoints, s; taken at episode ends.
        outage_seconds: how long a storage may refuse to take what is written before the attempt ends, s.
    """

    device: str = "cpu"
    threads: int = 1
    checkpoint_seconds: float = 600.0
    outage_seconds: float = 1800.0


@dataclass(frozen=True)
class Status:
    """Status of a running attempt.

    Attributes:
        step: environment steps of the run.
        steps_per_second: environment steps of this attempt over its wall time, 1/s.
        episodic_return: mean of the latest training episodes, NaN before the first.
    """

    step: int
    steps_per_second: float
    episodic_return: float
