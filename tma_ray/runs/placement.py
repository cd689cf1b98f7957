"""Placement, status and hardware fingerprint of runs."""

import json
import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tma_ray.console.exit_codes import installed_version
from tma_ray.students import Learner
from tma_ray.support.component_names import nearest
from tma_ray.support.quantities import PROCESSES, SECONDS
from tma_ray.support.validation import check_fields

DEVICES = ("cpu", "cuda", "mps", "xpu")
"""Torch devices on which a student can train; Ray counts CUDA's and Intel's as GPUs."""

PLAYER_NICENESS = 5  # added to the niceness of a worker's thread, since many workers wait for one learner

LIBRARIES = ("numpy", "torch", "stable-baselines3", "gymnasium", "pymunk", "numba", "scikit-learn", "scipy")


@dataclass(frozen=True)
class Placement:
    """Device, threads and checkpoint interval of a run; they do not affect results.

    Attributes:
        device: torch's name of the device of the networks.
        threads: torch's threads of the run.
        checkpoint_seconds: longest time between two checkpoints, which are taken at episode ends, s.
        outage_seconds: longest outage of the storage before the attempt ends, s.
        learner: learner of the cohort in which the student learns; None if it learns alone, on `device`.
    """

    device: str = "cpu"
    threads: int = 1
    checkpoint_seconds: float = 600.0
    outage_seconds: float = 1800.0
    learner: Learner | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        check_device(self.device)
        PROCESSES.check("threads", self.threads)
        SECONDS.check("checkpoint_seconds", self.checkpoint_seconds)
        SECONDS.check("outage_seconds", self.outage_seconds)

    def give_way(self) -> None:
        """Permanently lower the priority of the calling thread if the student learns in a cohort.

        Call it once per process. With more rollout workers than cores, all would otherwise wait for the
        learner, which waits for a core.
        """
        if self.learner is not None and hasattr(os, "nice"):
            os.nice(PLAYER_NICENESS)


@dataclass(frozen=True)
class Status:
    """Step, speed and recent return of a running attempt.

    Attributes:
        step: environment steps of the run.
        steps_per_second: environment steps of this attempt over its wall time, 1/s.
        episodic_return: mean of the latest training episodes, NaN before the first.
    """

    step: int
    steps_per_second: float
    episodic_return: float


def check_device(device: str) -> None:
    """Check that `device` is one of `DEVICES`, optionally with index 0."""
    kind, _, index = device.partition(":")
    if kind not in DEVICES:
        raise ValueError(f"device {device!r}: {nearest(kind, DEVICES)}expected one of {', '.join(DEVICES)}")
    if index.strip("0"):
        raise ValueError(
            f"device {device!r}: expected {kind!r}; Ray chooses the GPU and shows a run no other"
        )


def check_available(device: str) -> None:
    """Check that this machine has `device`."""
    if not is_available(device):
        raise ValueError(f"device {device!r}: torch finds none on this machine; use 'cpu'")


def is_available(device: str) -> bool:
    """Return True if this machine has `device`."""
    kind = device.partition(":")[0]
    if kind == "cpu":
        return True
    import torch

    available: dict[str, Callable[[], bool]] = {
        "cuda": torch.cuda.is_available,
        "mps": torch.backends.mps.is_available,
        "xpu": torch.xpu.is_available,
    }
    return available[kind]()


def fingerprint(threads: int, device: str, hardware: Mapping[str, Any] | None = None) -> str:
    """Return the CPU model, vector extensions, threads, device and library versions as JSON.

    Vector extensions distinguish CPUs whose model a virtual machine hides, such as "AMD EPYC".

    Args:
        threads: torch's threads of the run.
        device: torch's name of the device of a student that learns alone.
        hardware: result of `gpu` for that device, or of `ask_learner` for a cohort.
    """
    described = dict(hardware or {})
    if "vector_extensions" not in described:  # learners report theirs, since workers have no torch
        import torch

        described["vector_extensions"] = torch.backends.cpu.get_cpu_capability()
    content = {
        "tma_ray": installed_version("tma_ray"),
        "python": platform.python_version(),
        "system": platform.platform(terse=True),
        "cpu": cpu_model(),
        "threads": threads,
        "device": device,
        **described,
        **{library: installed_version(library) for library in LIBRARIES},
    }
    return json.dumps(content, sort_keys=True)


def gpu(device: str) -> dict[str, str]:
    """Return the entry for a GPU in a fingerprint, or {} for other devices."""
    if device.partition(":")[0] != "cuda" or not is_available(device):
        return {}
    import torch

    return {"gpu": torch.cuda.get_device_name(device)}


def usable_cores(root: Path = Path("/")) -> int:
    """Return the number of cores that this process may use, at least 1.

    It is limited by the CPU affinity, as set by ``taskset`` or a batch system, and by the quota of control
    groups (rounded down), as set for a container.

    Args:
        root: folder that holds ``proc`` and ``sys``.
    """
    affine = getattr(os, "sched_getaffinity", None)  # missing on macOS and Windows
    cores = len(affine(0)) if affine else os.cpu_count() or 1
    return max(1, int(min([cores, *_quotas(root)])))


def _quotas(root: Path) -> list[float]:
    """Return the CPU quotas, in cores, of this process's control groups and their parents (Linux only)."""
    groups, quotas = root / "proc/self/cgroup", []
    for line in groups.read_text().splitlines() if groups.exists() else []:
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        mount = root / "sys/fs/cgroup" / ("cpu" if controllers else "")  # cgroups v1 or v2
        group = mount / path.lstrip("/")
        # in a container, the path may be that of the host, which is not mounted
        for folder in [folder for folder in (group, *group.parents) if folder.is_relative_to(mount)]:
            quotas += _quota(folder)
    return quotas


def _quota(folder: Path) -> list[float]:
    """Return a control group's CPU quota in cores (cgroups v2 or v1), or an empty list if it has none."""
    try:
        if (limit := folder / "cpu.max").exists():
            quota, period = limit.read_text().split()
        else:
            quota, period = ((folder / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period"))
        return [int(quota) / int(period)] if int(quota) > 0 else []
    except (OSError, ValueError):  # there is no quota file, or the quota is "max"
        return []


def cpu_model() -> str:
    """Return the name of the processor."""
    description = Path("/proc/cpuinfo")
    if description.exists():
        for line in description.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
