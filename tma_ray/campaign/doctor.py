"""Diagnosis of this machine for campaigns: versions, engine, CPU, GPU, Ray, disk."""

from __future__ import annotations

import os
import platform
import shutil
from pathlib import Path

from tma_ray import __version__
from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.campaign.settings import GIB
from tma_ray.commands.exits import installed_version
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.results import SCHEMA_VERSION
from tma_ray.runs.placement import LIBRARIES, cpu_model

CPU_FEATURES = {"avx2": "AVX2", "avx512f": "AVX-512", "avx512_bf16": "AVX-512 BF16", "amx_bf16": "AMX BF16"}
"""Extensions that matter to matrix products, by their names in /proc/cpuinfo."""


def examine(root: Path) -> dict[str, str]:
    """Return the findings by topic; results would be on the disk of `root`."""
    import torch

    from tma_ray.physics import engine_in_use

    description, features = Path("/proc/cpuinfo"), "features unknown"
    if description.exists():
        flags = set(description.read_text().split())
        found = [name for flag, name in CPU_FEATURES.items() if flag in flags]
        features = ", ".join(found) or "without vector extensions that matter here"
    libraries = [f"{library} {installed_version(library)}" for library in (*LIBRARIES, "ray", "pyarrow")]
    engine = engine_in_use()
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / GIB
    gpus = range(torch.cuda.device_count() if torch.cuda.is_available() else 0)
    address = os.environ.get("RAY_ADDRESS")
    place = next(path for path in (root.absolute(), *root.absolute().parents) if path.exists())
    return {
        "tma_ray": f"{__version__}, Python {platform.python_version()}, {platform.platform(terse=True)}",
        "benchmark": f"version {BENCHMARK_VERSION}, physics {PHYSICS_VERSION}, schema {SCHEMA_VERSION}",
        "libraries": ", ".join(libraries),
        "physics engine": f"{engine.name}: {engine.reason}",
        "CPU": f"{cpu_model()}, {os.cpu_count()} cores, {features}",
        "memory": f"{memory:.1f} GiB",
        "GPU": ", ".join(map(torch.cuda.get_device_name, gpus)) or "none that torch can use",
        "Ray": f"would join {address} (RAY_ADDRESS)"
        if address
        else "would start on this machine; no RAY_ADDRESS",
        "free disk": f"{shutil.disk_usage(place).free / GIB:.1f} GiB at {place}",
    }
