"""Progress of campaigns, shown live by their driver or read from a results root on any machine."""

import math
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn, Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table as Grid
from rich.text import Text

from tma_ray.console.terminal import terminal
from tma_ray.results import (
    LOGS,
    TABLES,
    Heartbeat,
    HeartbeatWriter,
    LearnerProgress,
    Manifest,
    Results,
    RunProgress,
    RunStatus,
    Store,
    Table,
    TrialFile,
)
from tma_ray.runs.placement import Status
from tma_ray.support.texts import duration


def learner_line(learner: LearnerProgress) -> str:
    """Describe the progress of a cohort's learner in one line."""
    kind = "memory" if learner.device == "cpu" else "GPU memory"
    return (
        f"learner on {learner.host}, {learner.device}: {learner.runs} of {learner.width} slots, "
        f"{learner.updates_per_second:,.0f} updates/s, busy {learner.busy:.0%}, "
        f"{learner.memory_gib:.1f} of {learner.memory_total_gib:.1f} GiB {kind}"
    )


MAX_ROWS = 20  # largest number of runs in the live table


@dataclass(frozen=True)
class ActiveRun:
    """Run in training, with its budget in steps and its status."""

    run_id: str
    steps: int
    status: Status


@dataclass(frozen=True)
class Snapshot:
    """Progress of a campaign at one point in time.

    Attributes:
        total: runs of the campaign.
        done: runs whose results are published.
        failed: runs that raised, or were lost too often.
        stopped: runs that stopped with a checkpoint.
        waiting: runs not yet started, or starting.
        waiting_steps: environment steps of waiting runs.
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
        """Describe the progress in one line, with the time left at the current speed."""
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


class ProgressDisplay(Protocol):
    """Display of a campaign's progress."""

    def update(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""

    def close(self, snapshot: Snapshot) -> None:
        """Show the final snapshot."""


class HiddenProgress:
    """Display that shows nothing."""

    def update(self, snapshot: Snapshot) -> None:
        """Show nothing."""

    def close(self, snapshot: Snapshot) -> None:
        """Show nothing."""


class PublishedProgress:
    """Display that writes heartbeats to the results root, and passes snapshots on to another display."""

    def __init__(self, view: ProgressDisplay, heartbeat: HeartbeatWriter) -> None:
        self._view = view
        self._heartbeat = heartbeat

    def update(self, snapshot: Snapshot) -> None:
        """Write a heartbeat if one is due, and show the latest snapshot."""
        running = {
            run.run_id: RunProgress(run.status.step, run.status.steps_per_second) for run in snapshot.running
        }
        self._heartbeat.beat(running, snapshot.learners)
        self._view.update(snapshot)

    def close(self, snapshot: Snapshot) -> None:
        """Write the final heartbeat, and show the final snapshot."""
        self._heartbeat.end()
        self._view.close(snapshot)


class ProgressView:
    """Display that shows a live table on a terminal, and otherwise prints a line every `line_seconds`."""

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
        table = Grid(box=None, pad_edge=False)
        for heading in ("run", "step", "of", "steps/s", "episodic return"):
            table.add_column(heading, justify="left" if heading == "run" else "right")
        for run in snapshot.running[:MAX_ROWS]:
            status = run.status
            episodic_return = "" if math.isnan(status.episodic_return) else f"{status.episodic_return:.1f}"
            numbers = f"{status.step:,}", f"{run.steps:,}", f"{status.steps_per_second:,.0f}"
            table.add_row(run.run_id, *numbers, episodic_return)
        hidden = len(snapshot.running) - MAX_ROWS
        more = [Text(f"and {hidden} more running")] if hidden > 0 else []
        learners = [Text(learner_line(learner)) for learner in snapshot.learners]
        if not self._started:
            self._live.start()
            self._started = True
        shown = Group(Text(snapshot.headline(), style="bold"), *learners, table, *more)
        self._live.update(shown, refresh=True)

    def close(self, snapshot: Snapshot) -> None:
        """Show the final snapshot and end the live table."""
        if self._live is not None and self._started:
            self._live.update(Text(snapshot.headline()), refresh=True)
            self._live.stop()
        else:
            self._write(snapshot)

    def _write(self, snapshot: Snapshot) -> None:
        self._console.print(snapshot.headline(), highlight=False, soft_wrap=True)


CELL_COLUMNS = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
"""Columns that identify a cell."""

INTERRUPTED = "interrupted"  # state of an unfinished run after its last attempt or its campaign has ended
WAITING = "waiting"  # state of a run that was never started


@dataclass(frozen=True)
class RunState:
    """State of one run of a campaign.

    Attributes:
        run_id: id of the run.
        state: done, running, failed, interrupted or waiting.
        step: environment steps published or in the last heartbeat.
        steps: budget; 0 if it was never started.
        steps_per_second: speed in the last heartbeat, 1/s; 0 unless running.
        error: traceback or reason of a failure.
    """

    run_id: str
    state: str
    step: int
    steps: int
    steps_per_second: float = 0.0
    error: str | None = None


@dataclass(frozen=True)
class Overview:
    """State of the campaigns in a results root, with the last heartbeat and the trial, if any.

    Attributes:
        campaigns: runs by campaign and cell (values of `CELL_COLUMNS`).
        heartbeat: last heartbeat, or None if there was none.
        trial: trial in this root, or None.
    """

    campaigns: Mapping[str, Mapping[tuple[str, ...], list[RunState]]]
    heartbeat: Heartbeat | None
    trial: TrialFile | None = None

    @property
    def failed(self) -> bool:
        """True if a run has failed."""
        cells = chain.from_iterable(campaign.values() for campaign in self.campaigns.values())
        return any(run.state == RunStatus.FAILED for run in chain.from_iterable(cells))


def overview(root: str | Path, now: float) -> Overview:
    """Return the state of a root at the Unix time `now`."""
    return Observer(root).overview(now)


class Observer:
    """Reader of a root's state that rereads only changed files."""

    def __init__(self, root: str | Path) -> None:
        self._store = Store.open(root)
        self._results: Results | None = None
        self._steps: dict[str, tuple[Manifest, int]] = {}
        self._cached: dict[Table, tuple[object, list[dict[str, Any]]]] = {}

    def overview(self, now: float) -> Overview:
        """Return the state of the root at the Unix time `now`.

        Raises:
            ResultsRootError: if the root does not exist, or has another version.
        """
        self._results = results = Results(self._store, self._results)
        heartbeat = Heartbeat.load(self._store)
        running = heartbeat.runs if heartbeat is not None and heartbeat.alive(now) else None
        unfinished = {m.run.run_id: m for m in results.runs() if m.status is not RunStatus.DONE}
        outcomes: dict[str, tuple[int, str]] = {}
        columns = ["run_id", "attempt", "outcome"]
        for row in self._rows(Table.ATTEMPTS, unfinished, unfinished, columns):
            latest = row["attempt"], row["outcome"]
            outcomes[row["run_id"]] = max(outcomes.get(row["run_id"], (-1, "")), latest)
        steps, states = self._published_steps(unfinished), {}
        for manifest in results.runs():
            run_id, status, speed = manifest.run.run_id, manifest.status.value, 0.0
            step = steps.get(run_id, manifest.run.steps)
            if manifest.status is RunStatus.RUNNING:
                progress = running.get(run_id) if running else None
                if running is None or outcomes.get(run_id, (-1, ""))[0] == manifest.attempt:
                    status = INTERRUPTED
                elif progress is not None:
                    step, speed = max(step, progress.step), progress.steps_per_second
            states[run_id] = RunState(run_id, status, step, manifest.run.steps, speed, manifest.error)
        campaigns: dict[str, dict[tuple[str, ...], list[RunState]]] = {}
        for row in self._rows(Table.CELLS, unfinished):
            cells = campaigns.setdefault(row["campaign"], {})
            state = states.get(row["run_id"], RunState(row["run_id"], WAITING, 0, 0))
            cells.setdefault(tuple(row[name] for name in CELL_COLUMNS), []).append(state)
        return Overview(campaigns, heartbeat, TrialFile.load(self._store))

    def _rows(self, table: Table, unfinished: Collection[str], *which: Any) -> list[dict[str, Any]]:
        """Return the rows of a table, cached until one of its files or a run's state changes."""
        assert self._results is not None
        version = self._store.stamps(f"{TABLES}/{table}"), list(unfinished)
        if table not in self._cached or self._cached[table][0] != version:
            self._cached[table] = version, self._results.table(table, *which).to_pylist()
        return self._cached[table][1]

    def _published_steps(self, unfinished: Mapping[str, Manifest]) -> dict[str, int]:
        """Return the last published step of every unfinished run."""
        assert self._results is not None
        new = [
            run for run, manifest in unfinished.items() if self._steps.get(run, (None, 0))[0] is not manifest
        ]
        if new:
            rows = self._results.table(Table.EPISODES, new, ["run_id", "step"])
            grouped = rows.group_by("run_id").aggregate([("step", "max")]).to_pylist()
            last_steps = {row["run_id"]: row["step_max"] for row in grouped}
            self._steps |= {run: (unfinished[run], last_steps.get(run, 0)) for run in new}
        return {run: self._steps[run][1] for run in unfinished}


STATES = (RunStatus.DONE, RunStatus.RUNNING, INTERRUPTED, RunStatus.FAILED, WAITING)
MAX_ERRORS, MAX_RUNS = 5, 3  # largest number of errors listed, and of runs listed per error
MIN_NAME_WIDTH = 32  # minimum width of the first column, in characters
REFRESH_SECONDS = 5.0  # interval between updates of the live status, s


def show_status(root: str | Path, cells: bool = False, console: Console | None = None) -> bool:
    """Print the state of a root's campaigns and the causes of failures, and return True if runs failed.

    With `cells`, one line is printed per cell, otherwise one for all teachers and levels together.
    """
    now = time.time()
    state = overview(root, now)
    terminal(console).print(_status_page(root, state, cells, now), highlight=False)
    return state.failed


def watch_status(root: str | Path, cells: bool = False, console: Console | None = None) -> NoReturn:
    """Show the state of a root's campaigns, refreshed every `REFRESH_SECONDS`, until Ctrl-C."""
    observer = Observer(root)
    with Live(console=terminal(console), auto_refresh=False) as live:
        while True:
            now = time.time()
            live.update(_status_page(root, observer.overview(now), cells, now), refresh=True)
            time.sleep(REFRESH_SECONDS)


def _status_page(root: str | Path, overview: Overview, cells: bool, now: float) -> Group:
    trial: list[Text] = []
    if overview.trial is not None:
        design, looks = overview.trial.design, ", ".join(map(str, overview.trial.design["looks"]))
        state = f"ended ({overview.trial.ended})" if overview.trial.ended else "under way"
        against = f"Trial of {design['teacher']} against {design['release']}"
        trial.append(Text(f"{against}: {state}; looks after {looks} seeds"))
        trial += [Text(f"  {look.said}") for look in overview.trial.looks]
    if not overview.campaigns:
        return Group(*trial, Text(f"{root} holds no campaign yet."))
    parts: list[RenderableType] = [Text(_heartbeat_line(overview.heartbeat, now))]
    if overview.heartbeat is not None and overview.heartbeat.alive(now):
        parts += [Text(learner_line(learner)) for learner in overview.heartbeat.learners]
    parts += trial
    for campaign, by_cell in overview.campaigns.items():
        runs = _distinct(chain.from_iterable(by_cell.values()))
        done = sum(run.state == RunStatus.DONE for run in runs)
        speed = sum(run.steps_per_second for run in runs)
        budget = max((run.steps for run in runs), default=0)  # assumed for waiting runs, too
        left = sum((run.steps or budget) - run.step for run in runs if run.state != RunStatus.FAILED)
        eta = f", {speed:,.0f} steps/s, about {duration(left / speed)} left" if speed else ""
        headline = f"\ncampaign {campaign}: {done}/{len(runs)} runs done{eta}"
        groups: dict[str, list[RunState]] = {}
        for cell, members in by_cell.items():
            name = " · ".join(part for part in (cell if cells else cell[:4]) if part)
            groups.setdefault(name, []).extend(members)
        parts += [Text(headline, style="bold"), _grid(groups)]
        parts += [Text(line) for line in _failures(root, runs)]
    return Group(*parts)


def _heartbeat_line(heartbeat: Heartbeat | None, now: float) -> str:
    if heartbeat is None:
        return "No campaign has given a sign of life here."
    age = f"{duration(max(0.0, now - heartbeat.at))} ago"
    if heartbeat.alive(now):
        return f"Running: {heartbeat.holder}; last heartbeat {age}."
    date = datetime.fromtimestamp(heartbeat.at, UTC).strftime("%Y-%m-%d %H:%M UTC")
    end = "left" if heartbeat.ended else "had its last heartbeat"
    return f"No campaign is running. The last one, {heartbeat.holder}, {end} {age} ({date})."


def _grid(groups: dict[str, list[RunState]]) -> Grid:
    """Return a table with a row per group and a column per state that occurs."""
    members = {name: _distinct(runs) for name, runs in groups.items()}
    counts = {name: Counter(run.state for run in runs) for name, runs in members.items()}
    states = [state for state in STATES if any(count[state] for count in counts.values())]
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
    """Yield lines with the distinct errors, most frequent first, then commands to inspect and rerun runs."""
    kinds: dict[str, list[str]] = {}
    for run in runs:
        if run.state == RunStatus.FAILED:
            lines = (run.error or "").strip().splitlines()
            kinds.setdefault(lines[-1] if lines else "no message", []).append(run.run_id)
    ordered = sorted(kinds.items(), key=lambda kind: -len(kind[1]))
    for error, names in ordered[:MAX_ERRORS]:
        more = f" and {len(names) - MAX_RUNS} more" if len(names) > MAX_RUNS else ""
        yield f"failed: {error}\n  {', '.join(names[:MAX_RUNS])}{more}"
    if len(ordered) > MAX_ERRORS:
        yield f"and {len(ordered) - MAX_ERRORS} other errors"
    if ordered:
        yield f"Traceback: tma-ray logs {ordered[0][1][0]} --results {root}"
        yield f"Once mended: tma-ray rerun {root} --failed"


def _distinct(runs: Sequence[RunState] | Iterator[RunState]) -> list[RunState]:
    """Return the runs without duplicates, since cells may share runs."""
    return list({run.run_id: run for run in runs}.values())


def show_history(run: str, root: str | Path, console: Console | None = None) -> None:
    """Print the history of a run, given by its id or an unambiguous prefix.

    Raises:
        ValueError: if no run or more than one matches.
    """
    console, results = terminal(console), Results.open(root)
    manifest = results.find(run)
    run_id = manifest.run.run_id
    console.print(Text(f"{run_id}: {manifest.status}", style="bold"))
    for row in results.table(Table.ATTEMPTS, [run_id]).to_pylist():
        console.print(
            f"attempt {row['attempt']}: {row['outcome']} after {duration(row['wall_seconds'])} "
            f"on {row['host'] or 'an unknown host'}, from {row['started_at']:%Y-%m-%d %H:%M:%S} UTC on",
            highlight=False,
        )
    logs = results.store.files(f"{LOGS}/{run_id}")
    for path in logs:
        console.print(Text(f"\n{path}", style="bold"))
        text = results.store.read_bytes(path).decode(errors="replace").rstrip()
        console.print(text, markup=False, highlight=False, soft_wrap=True)
    if manifest.error and not logs:
        console.print(manifest.error.rstrip(), markup=False, highlight=False, soft_wrap=True)
