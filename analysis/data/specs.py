"""Settings from the specs of runs, and identities of a run's components, such as its teacher."""

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

import pandas as pd

from analysis.data.columns import FROM_SPEC
from tma_ray.results import CHIPMUNK
from tma_ray.support.decoding import DamagedFileError, decode_json
from tma_ray.tasks import MASTERY_RETURN

OF_BODIES = ("embodiment", "original_embodiment")
"""Environment options that duplicate the embodiment column; the second occurs in imported runs."""

BEFORE_VERSIONS = "before 1"  # algorithm version for specs that predate version numbers


SEED = re.compile(r'"seed": \d+, "student":')
"""Regular expression of the seed and the next key in a spec with sorted keys."""


def parsed(text: object) -> dict[str, Any]:
    """Return the JSON object in `text`, or an empty one if `text` is anything else."""
    try:
        return decode_json(text, dict[str, Any], "a spec") if isinstance(text, str) else {}
    except DamagedFileError:
        return {}


def mastery_threshold(spec: object) -> float:
    """Return the mastery threshold of a run, given its spec as JSON."""
    return float(parsed(spec).get("mastery_threshold", MASTERY_RETURN))


def with_settings(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with the columns `FROM_SPEC`, read from their specs.

    Specs are long and many, so those that differ in their seed alone are parsed once.
    """
    texts = []
    for text in runs["spec"]:
        seedless, count = SEED.subn('"student":', text, count=1)
        if not count:
            seedless = json.dumps({name: value for name, value in parsed(text).items() if name != "seed"})
        texts.append(seedless)
    columns = {}
    for text in set(texts):
        spec = parsed(text)
        threshold = float(spec.get("mastery_threshold", MASTERY_RETURN))
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        identities = json.dumps(identity(spec), sort_keys=True)
        columns[text] = str(spec.get("engine", CHIPMUNK)), threshold, digest, identities
    return runs.assign(**{name: [columns[text][i] for text in texts] for i, name in enumerate(FROM_SPEC)})


def identity(spec: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the settings that identify each part of a run, such as its teacher, by column of `NAMED`.

    Args:
        spec: spec of the run as JSON values; empty for a run without one.
    """
    options = {
        key: value for key, value in spec.get("environment_options", {}).items() if key not in OF_BODIES
    }
    files = {name: file["sha256"][:8] for name, file in spec.get("inputs", {}).items()}
    body = files.pop("environment.embodiment", None)
    steps = spec.get("schedule", {}).get("steps") or 1
    space = {axis["name"]: f"{axis['low']:g}..{axis['high']:g}" for axis in spec.get("task_space", ())}
    challenge = {
        "easy_task": spec.get("easy_task"),
        "cuts": spec.get("cuts", 0),
        "resets": [round(step / steps, 3) for step in spec.get("resets", ())],  # as shares of the budget
    }
    return {
        "environment": {**options, **_of_part(spec, "environment", files)},
        "challenge": space | challenge,
        "embodiment": {"sha256": body} if body else {},
        "student": {**spec.get("student_hyperparameters", {}), **_of_part(spec, "student", files)},
        "teacher": {**spec.get("teacher_hyperparameters", {}), **_of_part(spec, "teacher", files)},
        "test_set": {"sha256": digest_of(spec["test_set"])} if "test_set" in spec else {},
    }


def _of_part(spec: Mapping[str, Any], part: str, files: Mapping[str, str]) -> dict[str, Any]:
    """Return algorithm version, source and files of a part of a run; an empty dict if the spec lacks it."""
    if not spec or part not in spec:
        return {}
    settings: dict[str, Any] = {"algorithm_version": spec.get("algorithm_versions", {}).get(part)}
    plugin = spec.get("plugins", {}).get(part)
    if plugin is not None:
        settings["source"] = plugin["digest"][:8]
    elif settings["algorithm_version"] is None:
        settings["algorithm_version"] = BEFORE_VERSIONS
    return settings | {
        name.removeprefix(f"{part}."): sha256 for name, sha256 in files.items() if name.startswith(f"{part}.")
    }


def digest_of(value: Any) -> str:
    """Return a short hash of JSON values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:8]
