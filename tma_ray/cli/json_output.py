"""JSON output of commands, with stable keys, and null for missing numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tma_ray.support.texts import CONTROL

if TYPE_CHECKING:
    from tma_ray.campaign.costs import Cost
    from tma_ray.campaign.plan import Plan
    from tma_ray.campaign.progress import Overview

KEYS: Mapping[str, Mapping[str, str]] = {
    "run": {
        "run_id": "id of the run",
        "results": "results root",
        "mastered_area": "mean share of mastered test tasks over the budget, in percent",
        "last_three": "mean share of mastered test tasks at the last three evaluations, in percent",
        "curve": "list of step and mastered_percent, one for each evaluation",
        "policy": "folder of the policy, in the results root",
    },
    "status": {
        "root": "results root",
        "heartbeat": "sign of life of the last campaign: holder, at (s since 1970), alive; null without one",
        "campaigns": "list of name and cells; a cell has environment, challenge, embodiment, student, "
        "teacher, expert_knowledge and runs; a run has run_id, state (done, running, interrupted, failed "
        "or waiting), step, steps (0 if it never started), steps_per_second and error (null without one)",
        "trial": "design, looks (list of seeds and said, the verdicts in a sentence) and ended (why; empty "
        "before); null without one",
    },
    "ranking": {
        "root": "results root, the first of several",
        "roots": "list of all results roots and baselines that were read",
        "warnings": "limits of the data, in sentences",
        "share": "share of the budget after which runs were read",
        "measure": "measure of the ranking: mastered_area, last_three or mastered_percent",
        "rows": "results, the best of each challenge first, with columns of analysis.comparisons.sentences",
        "overall": "estimates over all challenges, with the columns of "
        "analysis.comparisons.leaderboards.overall",
        "sentences": "the rows in words",
    },
    "claims": {
        "root": "results root, the first of several",
        "roots": "list of all results roots and baselines that were read",
        "warnings": "limits of the data, in sentences",
        "claims": "list of text, source, standing, elsewhere (conditions that are not the paper's), needed "
        "(findings that must hold), and findings: standing and evidence of each statement",
    },
    "plan": {
        "experiment": "name of the experiment",
        "tier": "its size",
        "parts": "list of name, teachers, cells, asked (cells with their seeds), executed (runs) and steps",
        "cost": "hours (of all runs, one after the other), core_hours, gpu_hours, at_once (runs on this "
        "machine), wall_hours, disk_gib, checkpoint_gib and memory_gib",
        "detectable": "smallest detectable differences, with the columns of analysis.comparisons.planning",
    },
    "verify": {
        "root": "results root or release",
        "whole": "true if nothing is damaged",
        "runs": "number of runs with a readable manifest",
        "files": "number of files in their manifests",
        "damage": "list of path, problem and run_id (empty if the file holds several runs)",
        "unlisted": "paths of files of tables and policies that belong to no run",
        "lacking": "gaps of a release that is to be complete (empty without --complete)",
    },
    "list": {"kinds": "by kind (teachers, students, …): list of name and description"},
    "doctor": {"topics": "findings on this machine by topic"},
    "baselines list": {
        "baselines": "list of name, engine, runs, teachers, licence, partial (what is missing) and place"
    },
}
"""Keys of each command's JSON and their meaning; keys are added, never removed."""


def print_json(command: str, record: Mapping[str, Any]) -> None:
    """Print the JSON of a command; its keys must match `KEYS`."""
    assert list(record) == list(KEYS[command]), f"{command}: {list(record)}"
    text = json.dumps(json_value(record), indent=2, ensure_ascii=False, allow_nan=False)
    print(CONTROL.sub(lambda match: f"\\u{ord(match[0]):04x}", text))


def json_value(value: Any) -> Any:
    """Convert `value` for JSON, with None for NaN and infinities, and Python numbers for numpy's."""
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, Enum):
        value = value.value
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [json_value(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def status_record(root: str | Path, state: Overview, now: float) -> dict[str, Any]:
    """Return the JSON of ``status``: the state of every run at `now`, by campaign and cell."""
    from tma_ray.campaign.progress import CELL_COLUMNS  # imported late, since it imports pyarrow

    heartbeat = state.heartbeat
    return {
        "root": root,
        "heartbeat": heartbeat
        and {"holder": heartbeat.holder, "at": heartbeat.at, "alive": heartbeat.alive(now)},
        "campaigns": [
            {
                "name": name,
                "cells": [
                    {**dict(zip(CELL_COLUMNS, cell, strict=True)), "runs": [asdict(run) for run in runs]}
                    for cell, runs in cells.items()
                ],
            }
            for name, cells in state.campaigns.items()
        ],
        "trial": state.trial and {name: asdict(state.trial)[name] for name in ("design", "looks", "ended")},
    }


def ranking_record(sources: Sequence[str | Path], share: float, measure: str) -> dict[str, Any]:
    """Return the JSON of ``ranking`` at a share of the budget."""
    from analysis.baselines.catalogue import read
    from analysis.comparisons.leaderboards import overall
    from analysis.comparisons.sentences import ranked, ranking_sentences
    from analysis.measures.pooling import runs_after

    frames = read(sources)
    runs = runs_after(frames, share, training=False)
    table = ranked(runs, measure)
    return {
        "root": sources[0],
        "roots": list(sources),
        "warnings": list(frames.notes),
        "share": share,
        "measure": measure,
        "rows": table.to_dict("records"),
        "overall": overall(runs, measure).to_dict("records"),
        "sentences": ranking_sentences(table),
    }


def claims_record(sources: Sequence[str | Path]) -> dict[str, Any]:
    """Return the JSON of ``claims``."""
    from analysis.baselines.catalogue import read
    from analysis.claims.judging import root_verdicts

    frames = read(sources)
    verdicts, notes = root_verdicts(frames)
    return {
        "root": sources[0],
        "roots": list(sources),
        "warnings": [*frames.notes, *notes],
        "claims": [
            {
                "text": verdict.claim.text,
                "source": verdict.claim.source,
                "standing": verdict.standing,
                "elsewhere": verdict.conditions,
                "needed": verdict.needed,
                "findings": [
                    {"standing": finding.standing, "evidence": finding.evidence}
                    for finding in verdict.findings
                ],
            }
            for verdict in verdicts
        ],
    }


def plan_record(experiment: str, tier: str, plan: Plan, cost: Cost) -> dict[str, Any]:
    """Return the JSON of ``plan``."""
    from analysis.comparisons.planning import detectable_differences
    from tma_ray.campaign.plan import planned_experiments

    return {
        "experiment": experiment,
        "tier": tier,
        "parts": planned_experiments(plan),
        "cost": {
            name: getattr(cost, name)
            for name in (
                *("hours", "core_hours", "gpu_hours", "at_once", "wall_hours", "bound"),
                *("disk_gib", "checkpoint_gib", "memory_gib"),
            )
        },
        "detectable": detectable_differences(plan.cell_rows, plan.budgets).to_dict("records"),
    }


def baselines_record() -> dict[str, Any]:
    """Return the JSON of ``baselines list``."""
    from analysis.baselines.catalogue import baselines

    rows = [
        {
            "name": baseline.manifest.name,
            "engine": baseline.manifest.engine,
            "runs": baseline.manifest.holds.get("runs", 0),
            "teachers": list(baseline.manifest.holds.get("teachers", ())),
            "licence": baseline.manifest.licence,
            "partial": baseline.manifest.partial,
            "place": baseline.location,
        }
        for baseline in baselines()
    ]
    return {"baselines": rows}
