"""The state of the campaigns of a results root, from any machine that sees it; needs no Ray."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Generic, TypeVar

from tma_ray.results import TABLES, Heartbeat, Manifest, Results, RunProgress, RunStatus, Store, Table

T = TypeVar("T")

INTERRUPTED = "interrupted"
"""A run that has been started and is not done, and whose last attempt or campaign has ended."""

WAITING = "waiting"
"""A run that a campaign lists and that has not been started."""


@dataclass(frozen=True)
class RunState:
    """One run of a campaign.

    Attributes:
        run_id: its id.
        state: done, running, failed, interrupted or waiting.
        step: environment steps that are known of: published, or told by the campaign's last heartbeat.
        steps: its budget; 0 if it was never started.
        steps_per_second: as the last heartbeat tells; 0 of a run that is not running.
        error: why it failed.
    """

    run_id: str
    state: str
    step: int
    steps: int
    steps_per_second: float = 0.0
    error: str | None = None


@dataclass(frozen=True)
class Overview:
    """The campaigns of a results root.

    Attributes:
        campaigns: runs by campaign and by cell; a cell is named by what it consists of.
        heartbeat: the root's last; None if no campaign ever gave one.
    """

    campaigns: Mapping[str, Mapping[tuple[str, ...], list[RunState]]]
    heartbeat: Heartbeat | None

    @property
    def failed(self) -> bool:
        """True if a run has failed."""
        cells = chain.from_iterable(campaign.values() for campaign in self.campaigns.values())
        return any(run.state == RunStatus.FAILED for run in chain.from_iterable(cells))


def overview(root: str | Path, now: float) -> Overview:
    """Returns what is known of the runs of a root at `now`, s since 1970."""
    return Observer(root).look(now)


class Observer:
    """Looks at a root again and again, and reads only what has changed since the last look.

    Args:
        root: folder or URI of a results root.
    """

    def __init__(self, root: str | Path) -> None:
        self._store = Store.open(root)
        self._results: Results | None = None
        self._steps: dict[str, tuple[Manifest, int]] = {}
        self._outcomes = _Kept(self._store, Table.ATTEMPTS, _last_outcomes)
        self._cells = _Kept(self._store, Table.CELLS, _rows_of_cells)

    def look(self, now: float) -> Overview:
        """Returns what is known of the runs at `now`, s since 1970.

        Raises:
            ResultsRootError: the root does not exist, or is one of another version.
        """
        self._results = results = Results(self._store, self._results)
        heartbeat = Heartbeat.load(self._store)
        running = heartbeat.runs if heartbeat is not None and heartbeat.alive(now) else None
        steps, outcomes = self._published_steps(results), self._outcomes.of(results)
        states = {
            manifest.run.run_id: _state(
                manifest,
                steps.get(manifest.run.run_id, 0),
                outcomes.get(manifest.run.run_id),
                running,
            )
            for manifest in results.runs()
        }
        campaigns: dict[str, dict[tuple[str, ...], list[RunState]]] = {}
        for row in self._cells.of(results):
            cells = campaigns.setdefault(row["campaign"], {})
            state = states.get(row["run_id"], RunState(row["run_id"], WAITING, 0, 0))
            cells.setdefault(_cell(row), []).append(state)
        return Overview(campaigns, heartbeat)

    def _published_steps(self, results: Results) -> dict[str, int]:
        """Returns the step of the last published episode of every unfinished run."""
        unfinished = _unfinished(results)
        new = [
            run for run, manifest in unfinished.items() if self._steps.get(run, (None, 0))[0] is not manifest
        ]
        if new:
            rows = results.table(Table.EPISODES, new, ["run_id", "step"])
            grouped = rows.group_by("run_id").aggregate([("step", "max")]).to_pylist()
            found = {row["run_id"]: row["step_max"] for row in grouped}
            self._steps |= {run: (unfinished[run], found.get(run, 0)) for run in new}
        return {run: self._steps[run][1] for run in unfinished}


class _Kept(Generic[T]):
    """Rows about runs as `read` returned them, until a file of their table or a run's state changes."""

    def __init__(self, store: Store, table: Table, read: Callable[[Results], T]) -> None:
        self._store, self._folder, self._read = store, f"{TABLES}/{table}", read
        self._found: tuple[object, T] | None = None

    def of(self, results: Results) -> T:
        seen = self._store.stamps(self._folder), list(_unfinished(results))
        if self._found is None or self._found[0] != seen:
            self._found = seen, self._read(results)
        return self._found[1]


def _state(
    manifest: Manifest,
    step: int,
    outcome: tuple[int, str] | None,
    running: Mapping[str, RunProgress] | None,
) -> RunState:
    """Returns the state of a run; `running` is None where no campaign is."""
    state, speed = manifest.status.value, 0.0
    ended = running is None or (outcome is not None and outcome[0] == manifest.attempt)
    progress = running.get(manifest.run.run_id) if running else None
    if manifest.status is RunStatus.RUNNING and ended:
        state = INTERRUPTED
    elif manifest.status is RunStatus.RUNNING and progress is not None:
        step, speed = max(step, progress.step), progress.steps_per_second
    if manifest.status is RunStatus.DONE:
        step = manifest.run.steps
    return RunState(manifest.run.run_id, state, step, manifest.run.steps, speed, manifest.error)


def _rows_of_cells(results: Results) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = results.table(Table.CELLS).to_pylist()
    return rows


def _last_outcomes(results: Results) -> dict[str, tuple[int, str]]:
    """Number and outcome of the last recorded attempt at every unfinished run."""
    last: dict[str, tuple[int, str]] = {}
    columns = ["run_id", "attempt", "outcome"]
    for row in results.table(Table.ATTEMPTS, _unfinished(results), columns).to_pylist():
        last[row["run_id"]] = max(last.get(row["run_id"], (-1, "")), (row["attempt"], row["outcome"]))
    return last


def _unfinished(results: Results) -> dict[str, Manifest]:
    return {
        manifest.run.run_id: manifest for manifest in results.runs() if manifest.status is not RunStatus.DONE
    }


def _cell(row: Mapping[str, Any]) -> tuple[str, ...]:
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
    return tuple(row[name] for name in names)
