"""What a checkpoint costs: bytes and seconds, of SAC with a full replay buffer and of PPO.

Prints JSON. The full checkpoint of 2 million transitions is the reference; carry the ratios.

    python benchmarks/checkpoints.py --transitions 2M --output checkpoints.json
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.campaign.option_values import whole_number
from tma_ray.results import CHECKPOINTS, RunWriter, Store
from tma_ray.runs import Cell, InlineTeacher, Schedule, effective_spec
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.run import Run
from tma_ray.students import Transition

EPISODE_STEPS = 1_000
NEW_TRANSITIONS = (100_000, 500_000)
"""Between two checkpoints: what SAC plays in ten minutes on a core, and between two evaluations."""


def new_run(student: str, store: Store, attempt: int) -> Run:
    """Returns a run on Stump Tracks that has just begun."""
    spec = effective_spec(Cell(student=student, teacher="alp_gmm"), 0, Schedule())
    return Run(spec, InlineTeacher(spec), RunWriter(store, spec.run_id, attempt))


def fill(run: Run, count: int, rng: np.random.Generator) -> None:
    """Gives the student's buffer `count` transitions without training on them."""
    buffer = run.student._replay
    size = run.environment.observation_space.shape[0]
    observations = rng.standard_normal((EPISODE_STEPS + 1, size), dtype=np.float32)
    action = np.zeros(run.environment.action_space.shape[0], np.float32)
    for index in range(count):
        step = index % EPISODE_STEPS
        ended = step == EPISODE_STEPS - 1
        pair = observations[step], observations[step + 1]
        buffer.add(Transition(pair[0], action, 0.0, pair[1], ended, False), action)
    run.progress.step += count


def timed_save(run: Run, checkpoints: Checkpoints) -> dict[str, float]:
    """Returns what one checkpoint takes."""
    start = time.perf_counter()
    size = checkpoints.save(run, (), "benchmark")
    return {"megabytes": size / 1e6, "seconds": time.perf_counter() - start}


def measure(student: str, transitions: int) -> dict[str, Any]:
    """Returns the cost of a first checkpoint, of later ones, and of taking one up again."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as place:
        store = Store.open(place)
        run = new_run(student, store, 0)
        run.advance()
        checkpoints = Checkpoints(store, run.spec.run_id, 0)
        if student == "sac":
            fill(run, transitions, rng)
        rows: dict[str, Any] = {"student": student, "full": timed_save(run, checkpoints)}
        for new in NEW_TRANSITIONS if student == "sac" else ():
            fill(run, new, rng)
            rows[f"after {new:,} more"] = timed_save(run, checkpoints)
        files = [Path(place, path) for path in store.files(CHECKPOINTS)]
        rows["megabytes_kept"] = sum(path.stat().st_size for path in files) / 1e6
        successor = new_run(student, store, 1)
        start = time.perf_counter()
        Checkpoints(store, run.spec.run_id, 1).restore(successor)
        rows["restore_seconds"] = time.perf_counter() - start
    return rows


def main() -> None:
    """Measures both students."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--transitions", type=whole_number, default=2_000_000)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = [measure(student, options.transitions) for student in ("sac", "ppo")]
    print(json.dumps(rows, indent=1))
    if options.output:
        options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
