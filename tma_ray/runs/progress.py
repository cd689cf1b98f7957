"""Progress of a run; part of every checkpoint."""

from __future__ import annotations

from dataclasses import dataclass, field

from tma_ray.tasks import Task


@dataclass
class Progress:
    """Progress of a run; part of every checkpoint.

    Attributes:
        step: environment steps played.
        episodes: training episodes finished.
        evaluations: evaluations done.
        window: (episodic return, length, success) of the episodes of the running training window from which
            the student learned.
        next_task: what the teacher chose for the next episode.
        record_next: whether the teacher wants to see the steps of that episode.
        next_trains: whether the student learns from it.
    """

    step: int = 0
    episodes: int = 0
    evaluations: int = 0
    window: list[tuple[float, int, bool]] = field(default_factory=list)
    next_task: Task | None = None
    record_next: bool = False
    next_trains: bool = True
