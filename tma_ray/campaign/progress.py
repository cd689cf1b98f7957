"""Progress of a campaign, as its driver shows it: live on a terminal, in plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tma_ray.results import HeartbeatWriter, LearnerProgress, RunProgress
from tma_ray.runs.placement import Status
from tma_ray.terminal import terminal


def duration(seconds: float) -> str:
    """Return a time span in the two units that matter.

    Examples:
        >>> duration(42), duration(200), duration(7300), duration(200_000)
        ('42 s', '3 min 20 s', '2 h 1 min', '2 d 7 h')
    """
    units = [(86_400, "d"), (3_600, "h"), (60, "min"), (1, "s")]
    for (size, name), (smaller, smaller_name) in zip(units, [*units[1:], (0, "")], strict=True):
        if seconds >= size and smaller:
            return f"{int(seconds // size)} {name} {int(seconds % size // smaller)} {smaller_name}"
    return f"{int(seconds)} s"


def learner_line(learner: LearnerProgress) -> str:
    """Return the learner of a cohort in one line."""
    kind = "memory" if learner.device == "cpu" else "GPU memory"
    return (
        f"learner on {learner.host}, {learner.device}: {learner.runs} of {learner.width} slots, "
        f"{learner.updates_per_second:,.0f} updates/s, busy {learner.busy:.0%}, "
        f"{learner.memory_gib:.1f} of {learner.memory_total_gib:.1f} GiB {kind}"
    )


MOST_ROWS = 20
"""Running runs shown on a terminal; the others are counted."""


@dataclass(frozen=True)
class ActiveRun:
    """Progress of one run: its id, its budget in steps, and its status."""

    run_id: str
    steps: int
    status: Status


@dataclass(frozen=True)
class Snapshot:
    """Progress of a campaign at one moment.

    Attributes:
        total: runs of the campaign.
        done: runs whose results are published.
        failed: runs that raised, or died too often.
        stopped: runs that left with a checkpoint.
        waiting: runs not yet started, or still starting.
        waiting_steps: environment steps of those.
        total_steps: environment steps of all runs.
        running: runs that train.
        learners: learners of cohorts.
    """

    total: int
    done: int
    failed: int
    stopped: int
    waiting: int
    waiting_steps: int
    total_steps: int
    running: Sequence[ActiveRun]
    learners: Sequence[LearnerProgress] = ()

    def headline(self) -> str:
        """Return the campaign in one line, with the time left at the present speed."""
        parts = [f"{self.done}/{self.total} runs done"]
        parts += [f"{self.failed} failed"] if self.failed else []
        parts += [f"{self.stopped} stopped"] if self.stopped else []
        parts += [f"{self.waiting} waiting"] if self.waiting else []
        if self.running:
            left = self.waiting_steps + sum(run.steps - run.status.step for run in self.running)
            speed = sum(run.status.steps_per_second for run in self.running)
            share = f"{1 - left / self.total_steps:.0%} of {self.total_steps:,} steps"
            parts += [f"{len(self.running)} running", share, f"{speed:,.0f} steps/s"]
            parts += [f"about {duration(left / speed)} left"] if speed else []
        return ", ".join(parts)


class View(Protocol):
    """Display of a campaign's progress."""

    def update(self, snapshot: Snapshot) -> None:
        """Show the latest snapshot."""
        ...

    def close(self, snapshot: Snapshot) -> None:
        """Show the last snapshot."""
        ...


class PublishedProgress:
    """View that passes snapshots to another one, and writes them as heartbeats into the results root."""

    def __init__(self, view: View, heartbeat: HeartbeatWriter) -> None:
        self._view = view
        self._heartbeat = heartbeat

    def update(self, snapshot: Snapshot) -> None:
        """Show the latest snapshot."""
        running = {
            run.run_id: RunProgress(run.status.step, run.status.steps_per_second) for run in snapshot.running
        }
        self._heartbeat.beat(running, snapshot.learners)
        self._view.update(snapshot)

    def close(self, snapshot: Snapshot) -> None:
        """Show the last snapshot."""
        self._heartbeat.end()
        self._view.close(snapshot)


class ProgressView:
    """View with a live table on a terminal, else a line now and then."""

    def __init__(self, console: Console | None = None, line_seconds: float = 15.0) -> None:
        self._console = terminal(console)
        self._line_seconds = line_seconds
        self._last_line = -math.inf
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._started = False

    def update(self, snapshot: Snapshot) -> None:
        """Show the latest snapshot."""
        if self._live is None:
            if time.monotonic() - self._last_line >= self._line_seconds:
                self._write(snapshot)
                self._last_line = time.monotonic()
            return
        table = Table(box=None, pad_edge=False)
        for heading in ("run", "step", "of", "steps/s", "episodic return"):
            table.add_column(heading, justify="left" if heading == "run" else "right")
        for run in snapshot.running[:MOST_ROWS]:
            status = run.status
            episodic_return = "" if math.isnan(status.episodic_return) else f"{status.episodic_return:.1f}"
            numbers = f"{status.step:,}", f"{run.steps:,}", f"{status.steps_per_second:,.0f}"
            table.add_row(run.run_id, *numbers, episodic_return)
        hidden = len(snapshot.running) - MOST_ROWS
        more = [Text(f"and {hidden} more running")] if hidden > 0 else []
        learners = [Text(learner_line(learner)) for learner in snapshot.learners]
        if not self._started:
            self._live.start()
            self._started = True
        shown = Group(Text(snapshot.headline(), style="bold"), *learners, table, *more)
        self._live.update(shown, refresh=True)

    def close(self, snapshot: Snapshot) -> None:
        """Show the last snapshot and leave the terminal as it was."""
        if self._live is not None and self._started:
            self._live.update(Text(snapshot.headline()), refresh=True)
            self._live.stop()
        else:
            self._write(snapshot)

    def _write(self, snapshot: Snapshot) -> None:
        self._console.print(snapshot.headline(), highlight=False, soft_wrap=True)
