"""Status of the campaigns of a results root, printed once or kept up to date."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import NoReturn

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table as Grid
from rich.text import Text

from tma_ray.campaign.monitor.overview import (
    INTERRUPTED,
    WAITING,
    Observer,
    Overview,
    RunState,
    overview,
)
from tma_ray.campaign.monitor.wording import duration, learner_line
from tma_ray.results import Heartbeat, RunStatus
from tma_ray.terminal import terminal

COUNTED = (RunStatus.DONE, RunStatus.RUNNING, INTERRUPTED, RunStatus.FAILED, WAITING)
MOST_ERRORS, MOST_NAMES = 5, 3
"""Kinds of errors, and runs of each, that are named; the others are counted."""

MIN_NAME_WIDTH = 32
"""Of the first column, in characters."""

WATCH_SECONDS = 5.0
"""Time between two looks of a status that is watched, s."""


def show(root: str | Path, cells: bool = False, console: Console | None = None) -> bool:
    """Prints where the campaigns of a root stand, and why runs failed; returns whether any have.

    Args:
        root: folder or URI of a results root.
        cells: a line for every cell instead of one for every experiment, which joins its teachers.
        console: where to.
    """
    now = time.time()
    found = overview(root, now)
    terminal(console).print(_page(root, found, cells, now), highlight=False)
    return found.failed


def watch(root: str | Path, cells: bool = False, console: Console | None = None) -> NoReturn:
    """Shows it again every few seconds, until Ctrl-C."""
    observer = Observer(root)
    with Live(console=terminal(console), auto_refresh=False) as live:
        while True:
            now = time.time()
            live.update(_page(root, observer.look(now), cells, now), refresh=True)
            time.sleep(WATCH_SECONDS)


def _page(root: str | Path, found: Overview, cells: bool, now: float) -> Group:
    if not found.campaigns:
        return Group(Text(f"{root} holds no campaign yet."))
    parts: list[RenderableType] = [Text(_sign_of_life(found.heartbeat, now))]
    if found.heartbeat is not None and found.heartbeat.alive(now):
        parts += [Text(learner_line(learner)) for learner in found.heartbeat.learners]
    for campaign, by_cell in found.campaigns.items():
        runs = _distinct(chain.from_iterable(by_cell.values()))
        groups: dict[str, list[RunState]] = {}
        for cell, members in by_cell.items():
            name = " · ".join(part for part in (cell if cells else cell[:4]) if part)
            groups.setdefault(name, []).extend(members)
        parts += [Text(f"\ncampaign {campaign}: {_headline(runs)}", style="bold"), _grid(groups)]
        parts += [Text(line) for line in _failures(root, runs)]
    return Group(*parts)


def _sign_of_life(heartbeat: Heartbeat | None, now: float) -> str:
    if heartbeat is None:
        return "No campaign has given a sign of life here."
    age = f"{duration(max(0.0, now - heartbeat.at))} ago"
    if heartbeat.alive(now):
        return f"Running: {heartbeat.holder}; last heartbeat {age}."
    at = datetime.fromtimestamp(heartbeat.at, UTC).strftime("%Y-%m-%d %H:%M UTC")
    how = "left" if heartbeat.ended else "had its last heartbeat"
    return f"No campaign is running. The last one, {heartbeat.holder}, {how} {age} ({at})."


def _headline(runs: Sequence[RunState]) -> str:
    """Returns how many runs are done, how fast the others are, and when they will be done."""
    done = sum(run.state == RunStatus.DONE for run in runs)
    speed = sum(run.steps_per_second for run in runs)
    budget = max((run.steps for run in runs), default=0)  # also of those that have not been started
    left = sum((run.steps or budget) - run.step for run in runs if run.state != RunStatus.FAILED)
    eta = f", {speed:,.0f} steps/s, about {duration(left / speed)} left" if speed else ""
    return f"{done}/{len(runs)} runs done{eta}"


def _grid(groups: dict[str, list[RunState]]) -> Grid:
    """Returns a line for every group, with columns for the states that occur."""
    members = {name: _distinct(runs) for name, runs in groups.items()}
    counts = {name: Counter(run.state for run in runs) for name, runs in members.items()}
    states = [state for state in COUNTED if any(count[state] for count in counts.values())]
    grid = Grid(box=None, pad_edge=False)
    grid.add_column("environment · challenge · body · student", min_width=MIN_NAME_WIDTH)
    for name in (*states, "steps", "steps/s"):
        grid.add_column(str(name), justify="right", no_wrap=True)
    for name, runs in members.items():
        speed = sum(run.steps_per_second for run in runs)
        numbers = [str(counts[name][state] or "") for state in states]
        grid.add_row(name, *numbers, f"{sum(run.step for run in runs):,}", f"{speed:,.0f}" if speed else "")
    return grid


def _failures(root: str | Path, runs: Sequence[RunState]) -> Iterator[str]:
    """Yields what went wrong, the most frequent first, and how to see and repeat it."""
    kinds: dict[str, list[str]] = {}
    for run in runs:
        if run.state == RunStatus.FAILED:
            lines = (run.error or "").strip().splitlines()
            kinds.setdefault(lines[-1] if lines else "no message", []).append(run.run_id)
    ordered = sorted(kinds.items(), key=lambda kind: -len(kind[1]))
    for error, names in ordered[:MOST_ERRORS]:
        more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
        yield f"failed: {error}\n  {', '.join(names[:MOST_NAMES])}{more}"
    if len(ordered) > MOST_ERRORS:
        yield f"and {len(ordered) - MOST_ERRORS} other errors"
    if ordered:
        yield f"Traceback: tma-ray logs {ordered[0][1][0]} --results {root}"
        yield f"Once mended: tma-ray rerun {root} --failed"


def _distinct(runs: Sequence[RunState] | Iterator[RunState]) -> list[RunState]:
    """Returns every run once: cells may share them."""
    return list({run.run_id: run for run in runs}.values())
