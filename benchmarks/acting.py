"""Time to act per observation: a student, stable-baselines3's `predict`, and the torch module alone.

All three apply the same network and act greedily. Measured alternately in one process with one torch thread,
by processor time:

    python benchmarks/acting.py --students ppo sac
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from tma_ray.students import Student, make_student

SPACES = spaces.Box(-np.inf, np.inf, (24,), np.float32), spaces.Box(-1, 1, (4,), np.float32)
BATCHES = (1, 100)


def variants(name: str, student: Any, batch: np.ndarray[Any, Any]) -> dict[str, Callable[[], Any]]:
    """Return functions that act on `batch` (n, 24), by name; the student's own comes first."""
    model = student.model
    module = model.actor if name == "sac" else model.policy.get_distribution
    seen = student.normaliser.normalise(batch) if name == "ppo" else batch
    tensor = torch.from_numpy(seen)

    def call_module() -> Any:
        with torch.inference_mode():
            return module(tensor)

    chosen: dict[str, Callable[[], Any]] = {"act_greedily": lambda: student.act_greedily(batch)}
    if len(batch) == 1:
        chosen["act"] = lambda: student.act(batch[0])
    return chosen | {"predict": lambda: model.predict(seen, deterministic=True), "module": call_module}


def microseconds(call: Callable[[], Any], calls: int) -> float:
    """Return the mean processor time of one call, in µs."""
    start = time.thread_time()
    for _ in range(calls):
        call()
    return (time.thread_time() - start) / calls * 1e6


def measure(name: str, size: int, calls: int, repeats: int) -> dict[str, Any]:
    """Return the median times per observation over `repeats` rounds, and ratios to the student's."""
    values = {"exploration_steps": 0, "buffer_size": 1} if name == "sac" else {}
    student: Student = make_student(name, *SPACES, np.random.SeedSequence(0), values)
    batch = np.random.default_rng(0).normal(size=(size, 24)).astype(np.float32)
    calling = variants(name, student, batch)
    times: dict[str, list[float]] = {key: [] for key in calling}
    for repeat in range(repeats + 1):
        for key, call in calling.items():
            spent = microseconds(call, calls if repeat else 50) / size
            if repeat:
                times[key].append(spent)
    medians = {key: statistics.median(spent) for key, spent in times.items()}
    return {
        "student": name,
        "observations": size,
        "microseconds": {key: round(value, 2) for key, value in medians.items()},
        "ratio": {
            key: round(statistics.median(map(float.__truediv__, times[key], times["act_greedily"])), 1)
            for key in ("predict", "module")
        },
    }


def main() -> None:
    """Print a line per student and batch size, and write the results as JSON."""
    parser = argparse.ArgumentParser(
        allow_abbrev=False, description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--students", nargs="+", default=["ppo", "sac"], choices=["ppo", "sac"])
    parser.add_argument("--calls", type=int, default=1_000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--output", type=Path, default=Path("acting.json"))
    arguments = parser.parse_args()
    results = []
    for name in arguments.students:
        for size in BATCHES:
            results.append(measure(name, size, arguments.calls // (10 if size > 1 else 1), arguments.repeats))
            print(json.dumps(results[-1]))
    machine = {"machine": platform.machine(), "torch": torch.__version__, "threads": torch.get_num_threads()}
    arguments.output.write_text(json.dumps({**machine, "results": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
