"""Speeds that this machine has measured before, in a file of the user's cache."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import date
from pathlib import Path
from uuid import uuid4

from tma_ray import __version__
from tma_ray.campaign.costs.speed import Source, Throughput
from tma_ray.campaign.settings import Settings
from tma_ray.decoding import MOST_TEXT_BYTES, read_file
from tma_ray.runs.placement import fingerprint
from tma_ray.runs.spec import RunSpec

LONGEST_DAYS = 30
"""Age up to which a measurement is used, in days."""


def speeds_file() -> Path:
    """Returns where speeds are remembered, in the folder that XDG_CACHE_HOME names, else ~/.cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(cache) / "tma_ray" / "speeds.json"


def speed_key(spec: RunSpec, settings: Settings, at_once: int) -> str:
    """Returns a digest of what the speed of runs like `spec` depends on: machine, versions and settings."""
    content = {
        "machine": (platform.node(), os.cpu_count(), at_once),
        "fingerprint": fingerprint(settings.each.threads, settings.device),
        "version": (__version__, spec.physics_version, sorted(spec.algorithm_versions.items())),
        "environment": (spec.environment, sorted(spec.environment_options.items())),
        "student": (spec.student, sorted(spec.student_hyperparameters.items())),
        "inputs": sorted((option, file.sha256) for option, file in spec.inputs.items()),
        **({"cohort": settings.width} if settings.width else {}),
        "plugins": sorted((part, plugin.digest) for part, plugin in spec.plugins.items()),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:32]


def remembered() -> dict[str, Throughput]:
    """Returns the speeds that are not too old, by key; none where the file is missing or damaged."""
    try:
        entries = json.loads(read_file(speeds_file(), MOST_TEXT_BYTES))
        known = {key: Throughput(**{**entry, "source": Source.REMEMBERED}) for key, entry in entries.items()}
        ages = {
            key: (date.today() - date.fromisoformat(each.measured_on)).days for key, each in known.items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
    return {key: each for key, each in known.items() if 0 <= ages[key] <= LONGEST_DAYS}


def remember(measured: Mapping[str, Throughput]) -> None:
    """Adds measurements of today to the file; where it cannot be written, the next plan measures again."""
    file, today = speeds_file(), date.today().isoformat()
    entries = remembered() | {key: replace(each, measured_on=today) for key, each in measured.items()}
    aside = file.with_name(f"{file.name}.{uuid4().hex}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        aside.write_text(json.dumps({key: asdict(each) for key, each in entries.items()}, indent=1))
        aside.replace(file)
    except OSError:
        with suppress(OSError):
            aside.unlink()
