"""JSON on standard output, for scripts: stable keys, and null for a missing number."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from tma_ray.commands.texts import OBEYED

KEYS: Mapping[str, Mapping[str, str]] = {
    "status": {
        "root": "results root",
        "heartbeat": "of the last campaign: holder, at (s since 1970), alive; null if there was none",
        "campaigns": "list of name and cells; a cell has environment, challenge, embodiment, student, "
        "teacher, expert_knowledge and runs; a run has run_id, state (done, running, interrupted, failed "
        "or waiting), step, steps (0 if it never started), steps_per_second and error (null without one)",
    },
    "ranking": {
        "root": "results root, the first of several",
        "roots": "list of all results roots and baselines that were read",
        "warnings": "list of what to know before trusting the rows",
        "share": "share of the budget after which runs were read",
        "measure": "what teachers are ranked by: mastered_percent, last_three or mastered_area",
        "rows": "results, the best of each challenge first, with the columns of "
        "analysis.comparisons.sentences.ranking",
        "overall": "estimates over all challenges, with the columns of analysis.comparisons.boards.overall",
        "sentences": "the rows in words",
    },
    "claims": {
        "root": "results root, the first of several",
        "roots": "list of all results roots and baselines that were read",
        "warnings": "list of what to know before trusting the claims",
        "claims": "list of text, source, standing, and findings: standing and evidence of each statement",
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
        "whole": "whether nothing is damaged",
        "runs": "how many have a manifest that can be read",
        "files": "how many their manifests list",
        "damage": "list of path, problem and run_id (empty if the file holds several runs)",
        "unlisted": "paths of files of tables and policies that belong to no run",
        "lacking": "list of what a release lacks to be complete (empty without --complete)",
    },
    "list": {
        "kinds": "by kind (teachers, students, …): list of name and description",
    },
    "doctor": {
        "topics": "findings on this machine by topic",
    },
    "baselines list": {
        "baselines": "list of name, engine, runs, teachers, licence, partial (what is missing) and place",
    },
}
"""Keys of the JSON of each command that prints some, and their meaning; keys are added, never taken away."""


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Adds ``--json``."""
    parser.add_argument("--json", action="store_true", help="print JSON for scripts instead of text")


def print_json(command: str, record: Mapping[str, Any]) -> None:
    """Prints what `command` has found, with the keys that `KEYS` declares."""
    assert list(record) == list(KEYS[command]), f"{command}: {list(record)}"
    text = json.dumps(json_value(record), indent=2, ensure_ascii=False, allow_nan=False)
    print(OBEYED.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def json_value(value: Any) -> Any:
    """Returns `value` as JSON has it: NaN and infinities as null, numbers of numpy as Python's."""
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
