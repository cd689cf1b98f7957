"""Runs of a results root again: those that failed, or those that are named."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from tma_ray.campaign.plan import Plan
from tma_ray.campaign.script import run_plan
from tma_ray.commands.texts import counted
from tma_ray.results import Inspector, Results, RunRecord, RunStatus
from tma_ray.runs.inputs import fetch
from tma_ray.runs.plugins import import_plugins
from tma_ray.runs.spec import RunSpec

NAME = "rerun"
"""What a rerun is called where a campaign has its name."""


def rerun(options: argparse.Namespace) -> int:
    """Runs what the flags of ``tma-ray rerun`` name, from their checkpoints if they have some.

    Raises:
        ValueError: nothing is named, no such run, or a plug-in that was edited since.
    """
    return run_plan(rerun_plan(options.root, options.runs, failed=options.failed), options.root, options)


def rerun_plan(root: str, names: Sequence[str], *, failed: bool) -> Plan:
    """Returns the plan of unfinished runs of a root.

    Args:
        root: folder or URI of a results root.
        names: ids of runs, or unambiguous beginnings of them.
        failed: all that failed.

    Raises:
        ValueError: nothing is named, no such run, one that is done, or a plug-in that was edited since:
            its runs would be others, of the campaign that it belongs to.
    """
    results = Results.open(root)
    chosen = {manifest.run.run_id: manifest for manifest in map(results.find, names)}
    if failed:
        chosen |= {m.run.run_id: m for m in results.runs() if m.status is RunStatus.FAILED}
    if not chosen:
        raise ValueError(
            f"no run of {root} failed" if failed else "pass run IDs or --failed, for all that failed"
        )
    whole = [m for m in chosen.values() if m.status is RunStatus.DONE]
    for manifest, found in Inspector(results.store).inspect_all(whole):
        if not found.damage:
            raise ValueError(f"run {manifest.run.run_id} is done: there is nothing to run again")
    specs = tuple(_spec(manifest.run) for manifest in chosen.values())
    for spec in specs:
        fetch(results.store, spec)
    return Plan(NAME, f"{counted(len(chosen), 'run')} again", specs, ())


def _spec(run: RunRecord) -> RunSpec:
    spec = RunSpec.from_json(run.spec, f"the spec of run {run.run_id}")
    if spec.run_id != run.run_id:
        raise ValueError(
            f"the spec of run {run.run_id} is not its own: its manifest was edited or is damaged"
        )
    try:
        import_plugins(spec, *spec.plugins)
    except ValueError as error:
        raise ValueError(
            f"run {run.run_id}: {error}; with an edited plug-in, start the campaign's own command"
        ) from error
    return spec
