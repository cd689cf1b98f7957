"""What a results root says of its campaigns, from any machine that sees it; needs no Ray."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from tma_ray.results import AttemptOutcome, Manifest, Results, RunStatus, Table

INTERRUPTED = "interrupted"
"""A run that has been started and is not done, and whose last attempt is known to have ended."""

WAITING = "waiting"
"""A run that a campaign lists and nobody has started."""


@dataclass(frozen=True)
class RunState:
    """One run of a campaign.

    Attributes:
        run_id: its id.
        state: done, running, failed, interrupted or waiting.
        step: environment steps that are published.
        steps: its budget; 0 if it was never started.
        error: why it failed.
    """

    run_id: str
    state: str
    step: int
    steps: int
    error: str | None = None


def overview(root: str | Path) -> dict[str, dict[str, list[RunState]]]:
    """Returns the runs of a root by campaign and by a line that names their cell."""
    results = Results.open(root)
    manifests = {manifest.run.run_id: manifest for manifest in results.runs()}
    steps, outcomes = _published_steps(results), _last_outcomes(results)
    states = {
        run_id: _state(manifest, steps.get(run_id, 0), outcomes.get(run_id))
        for run_id, manifest in manifests.items()
    }
    campaigns: dict[str, dict[str, list[RunState]]] = {}
    for row in results.table(Table.CELLS).to_pylist():
        cells = campaigns.setdefault(row["campaign"], {})
        state = states.get(row["run_id"], RunState(row["run_id"], WAITING, 0, 0))
        cells.setdefault(_cell_name(row), []).append(state)
    return campaigns


def show(root: str | Path, console: Console | None = None) -> None:
    """Prints the overview of a root, and why runs failed."""
    console = console or Console()
    campaigns = overview(root)
    if not campaigns:
        console.print(f"{root} holds no campaign yet.", highlight=False)
    for campaign, cells in campaigns.items():
        grid = Grid(title=f"campaign {campaign}", title_justify="left", box=None)
        grid.add_column("cell")
        for name in ("done", "running", INTERRUPTED, "failed", WAITING, "steps"):
            grid.add_column(name, justify="right")
        for cell, runs in cells.items():
            count = Counter(run.state for run in runs)
            counts = [str(count[name] or "") for name in ("done", "running", INTERRUPTED, "failed", WAITING)]
            grid.add_row(cell, *counts, f"{sum(run.step for run in runs):,}")
        console.print(grid)
        for run in {run.run_id: run for runs in cells.values() for run in runs}.values():
            if run.error:
                console.print(f"failed: {run.run_id}\n{run.error.rstrip()}", markup=False, highlight=False)


def _state(manifest: Manifest, step: int, outcome: tuple[int, str] | None) -> RunState:
    state = manifest.status.value
    ended = outcome is not None and outcome[0] == manifest.attempt
    if manifest.status is RunStatus.RUNNING and ended:
        state = INTERRUPTED
    if manifest.status is RunStatus.DONE:
        step = manifest.run.steps
    return RunState(manifest.run.run_id, state, step, manifest.run.steps, manifest.error)


def _published_steps(results: Results) -> dict[str, int]:
    """Step of the last published episode of every unfinished run."""
    unfinished = [m.run.run_id for m in results.runs() if m.status is not RunStatus.DONE]
    rows = results.table(Table.EPISODES, unfinished, ["run_id", "step"])
    grouped = rows.group_by("run_id").aggregate([("step", "max")]).to_pylist()
    return {row["run_id"]: row["step_max"] for row in grouped}


def _last_outcomes(results: Results) -> dict[str, tuple[int, str]]:
    """Number and outcome of every run's last recorded attempt."""
    last: dict[str, tuple[int, str]] = {}
    for row in results.table(Table.ATTEMPTS, columns=["run_id", "attempt", "outcome"]).to_pylist():
        assert row["outcome"] in list(AttemptOutcome)
        last[row["run_id"]] = max(last.get(row["run_id"], (-1, "")), (row["attempt"], row["outcome"]))
    return last


def _cell_name(row: Mapping[str, Any]) -> str:
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
    return " · ".join(row[name] for name in names if row[name])
