"""The state of the campaigns of a results root, from any machine that sees it; needs no Ray."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from tma_ray.results import Heartbeat, Manifest, Results, RunProgress, RunStatus, Table

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
    results = Results.open(root)
    heartbeat = Heartbeat.load(results.store)
    running = heartbeat.runs if heartbeat is not None and heartbeat.alive(now) else None
    steps, outcomes = _published_steps(results), _last_outcomes(results)
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
    for row in results.table(Table.CELLS).to_pylist():
        cells = campaigns.setdefault(row["campaign"], {})
        state = states.get(row["run_id"], RunState(row["run_id"], WAITING, 0, 0))
        cells.setdefault(_cell(row), []).append(state)
    return Overview(campaigns, heartbeat)


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


def _published_steps(results: Results) -> dict[str, int]:
    """Step of the last published episode of every unfinished run."""
    unfinished = _unfinished(results)
    if not unfinished:
        return {}
    rows = results.table(Table.EPISODES, unfinished, ["run_id", "step"])
    grouped = rows.group_by("run_id").aggregate([("step", "max")]).to_pylist()
    return {row["run_id"]: row["step_max"] for row in grouped}


def _last_outcomes(results: Results) -> dict[str, tuple[int, str]]:
    """Number and outcome of the last recorded attempt at every unfinished run."""
    last: dict[str, tuple[int, str]] = {}
    columns = ["run_id", "attempt", "outcome"]
    for row in results.table(Table.ATTEMPTS, _unfinished(results), columns).to_pylist():
        last[row["run_id"]] = max(last.get(row["run_id"], (-1, "")), (row["attempt"], row["outcome"]))
    return last


def _unfinished(results: Results) -> list[str]:
    return [manifest.run.run_id for manifest in results.runs() if manifest.status is not RunStatus.DONE]


def _cell(row: Mapping[str, Any]) -> tuple[str, ...]:
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
    return tuple(row[name] for name in names)
