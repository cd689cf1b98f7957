"""Size and time of checkpoints: of SAC with a full replay buffer, and of PPO.

Prints JSON. Later checkpoints write only changed data: compare them with the full one of the same run.

    python benchmarks/checkpoints.py --transitions 2M --output checkpoints.json
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.results import CHECKPOINTS, RunWriter, Store
from tma_ray.runs import Cell, InlineTeacher, Schedule, effective_spec
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.run import Run
from tma_ray.students import Transition
from tma_ray.support.quantities import COUNT

EPISODE_STEPS = 1_000
NEW_TRANSITIONS = (100_000, 500_000)
"""Numbers of transitions between two checkpoints: ten minutes of SAC on a core, and one evaluation
interval."""

WITHOUT_UPDATES = {"updates": "interleaved", "exploration_steps": 10**9}
"""Hyper-parameters with which SAC only stores transitions."""


def new_run(student: str, store: Store, attempt: int) -> Run:
    """Return a new run on Stump Tracks."""
    values = WITHOUT_UPDATES if student == "sac" else {}
    cell = Cell(student=student, teacher="alp_gmm", student_hyperparameters=values)
    spec = effective_spec(cell, 0, Schedule())
    return Run(spec, InlineTeacher(spec), RunWriter(store, spec.run_id, attempt))


def fill(run: Run, count: int, rng: np.random.Generator) -> None:
    """Add `count` random transitions to the replay buffer of a run, without training."""
    spaces = run.environment.observation_space, run.environment.action_space
    shape, action_shape = (space.shape or () for space in spaces)
    observations = rng.standard_normal((EPISODE_STEPS + 1, *shape), dtype=np.float32)
    action = np.zeros(action_shape, np.float32)
    for index in range(count):
        step = index % EPISODE_STEPS
        ended = step == EPISODE_STEPS - 1
        pair = observations[step], observations[step + 1]
        run.student.observe(Transition(pair[0], action, 0.0, pair[1], ended, False))
    run.progress.step += count


def timed_save(run: Run, checkpoints: Checkpoints) -> dict[str, float]:
    """Save a checkpoint; return its megabytes and seconds."""
    start = time.perf_counter()
    size = checkpoints.save(run, (), "benchmark")
    return {"megabytes": size / 1e6, "seconds": time.perf_counter() - start}


def measure(student: str, transitions: int, more: Sequence[int]) -> dict[str, Any]:
    """Return sizes and times of a first checkpoint, of checkpoints after `more` transitions, of a restore."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as place:
        store = Store.open(place)
        run = new_run(student, store, 0)
        run.advance()
        checkpoints = Checkpoints(store, run.spec.run_id, 0)
        if student == "sac":
            fill(run, transitions, rng)
        rows: dict[str, Any] = {"student": student, "full": timed_save(run, checkpoints)}
        for new in more if student == "sac" else ():
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
    """Measure both students."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--transitions", type=COUNT, default=2_000_000, help="in the first checkpoint")
    parser.add_argument(
        "--more", type=COUNT, nargs="+", default=NEW_TRANSITIONS, help="before each of the next ones"
    )
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = [measure(student, options.transitions, options.more) for student in ("sac", "ppo")]
    print(json.dumps(rows, indent=1))
    if options.output:
        options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
