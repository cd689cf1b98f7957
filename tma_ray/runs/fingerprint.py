"""On what a run was computed: bit-identical results are promised on equal fingerprints only."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("numpy", "torch", "stable-baselines3", "gymnasium", "pymunk", "numba", "scikit-learn", "scipy")


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
