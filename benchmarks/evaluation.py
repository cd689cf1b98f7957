"""Speed of an evaluation: all tasks of the test set in lock-step, beside one task after the other.

    python benchmarks/evaluation.py --root results --output evaluation.json

Plays the best policy of a results root (a finished quickstart); without one, an untrained policy.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from pathlib import Path

import numpy as np

from tma_ray.envs import make_environment
from tma_ray.results import POLICIES, Results, Table
from tma_ray.runs import Cell, Schedule, effective_spec
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.streams import evaluation_seeds
from tma_ray.students import make_student


def student_of(root: Path | None):
    """Returns a PPO student with the best policy of `root`."""
    environment = make_environment("stump_tracks")
    spaces = environment.observation_space, environment.action_space
    student = make_student("ppo", *spaces, np.random.SeedSequence(0))
    if root is None:
        return student.act_greedily
    rows = (
        Results.open(root).table(Table.EVALUATIONS, columns=["run_id", "step", "episodic_return"]).to_pandas()
    )
    last = rows[rows.step == rows.step.max()]
    best = last.groupby("run_id", observed=True).episodic_return.mean().idxmax()
    return type(student).load_policy(root / POLICIES / str(best))


class Greedy:
    """A policy where an evaluation expects a student."""

    def __init__(self, policy) -> None:
        self.act_greedily = policy


def one_by_one(spec, policy) -> int:
    """Plays the test set one task after the other; returns the steps."""
    environment = make_environment(spec.environment, **spec.environment_options)
    steps = 0
    for task, seed in zip(spec.test_set.tasks, evaluation_seeds(spec.test_set), strict=True):
        observation, _ = environment.reset(seed=seed, options={"task": task})
        over = False
        while not over:
            observation, _, terminated, truncated, _ = environment.step(policy(observation[None])[0])
            over, steps = terminated or truncated, steps + 1
    return steps


def main() -> None:
    """Measures both ways in one run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    policy = student_of(options.root)
    spec = effective_spec(Cell(student="ppo"), 0, Schedule())
    evaluation = Evaluation(spec)
    start = time.perf_counter()
    rows = evaluation(Greedy(policy))
    seconds = time.perf_counter() - start
    steps = sum(row["length"] for row in rows)
    start = time.perf_counter()
    other_steps = one_by_one(spec, policy)
    other_seconds = time.perf_counter() - start
    result = {
        "machine": platform.machine(),
        "mean_length": steps / len(rows),
        "seconds": seconds,
        "steps_per_second": steps / seconds,
        "ratio_to_one_by_one": (steps / seconds) / (other_steps / other_seconds),
    }
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
