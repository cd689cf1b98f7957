"""Placement and status of a run, and the fingerprint of what computes it: no part of its specification."""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("numpy", "torch", "stable-baselines3", "gymnasium", "pymunk", "numba", "scikit-learn", "scipy")


@dataclass(frozen=True)
class Placement:
    """Placement of a run, which does not change what it computes.

    Attributes:
        device: torch's name of where networks live.
        threads: torch's threads of the run.
        checkpoint_seconds: longest time between two checkpoints, s; taken at episode ends.
        outage_seconds: how long a storage may refuse to take what is written before the attempt ends, s.
    """

    device: str = "cpu"
    threads: int = 1
    checkpoint_seconds: float = 600.0
    outage_seconds: float = 1800.0


@dataclass(frozen=True)
class Status:
    """Status of a running attempt.

    Attributes:
        step: environment steps of the run.
        steps_per_second: environment steps of this attempt over its wall time, 1/s.
        episodic_return: mean of the latest training episodes, NaN before the first.
    """

    step: int
    steps_per_second: float
    episodic_return: float


def fingerprint(threads: int, device: str) -> str:
    """Returns CPU model, threads, device and versions of what computes, as JSON."""
    content = {
        "tma_ray": version("tma_ray"),
        "python": platform.python_version(),
        "system": platform.platform(terse=True),
        "cpu": cpu_model(),
        "threads": threads,
        "device": device,
        **{library: version(library) for library in LIBRARIES},
    }
    return json.dumps(content, sort_keys=True)


def cpu_model() -> str:
    """Returns the name of the processor."""
    description = Path("/proc/cpuinfo")
    if description.exists():
        for line in description.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
