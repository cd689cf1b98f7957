"""Specs of runs as JSON: their settings, and what comparisons need of them."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

import pandas as pd

from analysis.data.identity import identity
from tma_ray.decoding import DamagedFileError, decode_json
from tma_ray.results import CHIPMUNK
from tma_ray.tasks import MASTERY_RETURN

SETTINGS = ["engine", "mastery_threshold", "settings", "identity"]
"""Columns of cells that come from the spec; settings is a short hash of all of it but the seed, identity the
JSON of `identity.identity`."""

SEED = re.compile(r'"seed": \d+, "student":')
"""The seed in a spec, whose keys are sorted, with the key that follows it."""


def parsed(text: object) -> dict[str, Any]:
    """Returns the JSON object in `text`, or an empty one if it holds something else."""
    try:
        return decode_json(text, dict[str, Any], "a spec") if isinstance(text, str) else {}
    except DamagedFileError:
        return {}


def mastery_threshold(spec: object) -> float:
    """Returns the episodic return over which tasks are mastered in a run with this `spec` (JSON)."""
    return float(parsed(spec).get("mastery_threshold", MASTERY_RETURN))


def with_settings(runs: pd.DataFrame) -> pd.DataFrame:
    """Adds what comparisons need of each run's spec: engine, mastery_threshold, settings and identity.

    A spec is long, and there are thousands: those that differ in their seed alone are parsed once.
    """
    texts = [_without_seed(spec) for spec in runs["spec"]]
    known = {text: _settings(text) for text in set(texts)}
    return runs.assign(**{name: [known[text][name] for text in texts] for name in SETTINGS})


def thresholds_of(evaluations: pd.DataFrame, runs: pd.DataFrame) -> pd.Series | float:
    """Returns the threshold of each evaluation's run; one number where all have the same."""
    known = runs["mastery_threshold"].unique()
    if len(known) == 1:
        return float(known[0])
    return evaluations["run_id"].map(runs.set_index("run_id")["mastery_threshold"]).astype(float)


def _without_seed(spec: str) -> str:
    text, found = SEED.subn('"student":', spec, count=1)
    content = {} if found else parsed(spec)
    return text if found else json.dumps({name: content[name] for name in content if name != "seed"})


def _settings(text: str) -> dict[str, Any]:
    spec = parsed(text)
    return {
        "engine": str(spec.get("engine", CHIPMUNK)),
        "mastery_threshold": float(spec.get("mastery_threshold", MASTERY_RETURN)),
        "settings": hashlib.sha256(text.encode()).hexdigest()[:12],
        "identity": json.dumps(identity(spec), sort_keys=True),
    }
