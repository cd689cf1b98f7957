"""Sample Parkour's three test sets: 100 feasible tasks each, a third of them easy, medium and hard.

python docs/making/make_parkour_test_sets.py --output tma_ray/benchmark/test_sets

As in the paper, 60 tasks are from the medium task space, 20 have a theta outside it, and 20 another delta.
Prints the shares of random tasks that are feasible, and the limits of the thirds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from parkour_demands import demands, difficulty

from tma_ray.benchmark import find_challenge
from tma_ray.tasks import TestSet
from tma_ray.terrain.parkour import CPPN, parkour

MEDIUM = find_challenge("parkour", "original").task_space
HARD = find_challenge("parkour", "hard").task_space
BODY_TYPES = {"walking": "walker", "swimming": "swimmer", "climbing": "climber"}
DELTA = (5.0, 30.0)
"""Range of deltas, apart from 10, the delta of the medium space."""

REFERENCE_TASKS = 3000
"""Number of random tasks of the medium space for the limits of the thirds."""

DECIMALS = 4

Draw = Callable[[np.random.Generator], np.ndarray]


def inside(rng: np.random.Generator) -> np.ndarray:
    """Return a random task (8,) of the medium space."""
    return MEDIUM.clip(np.round(MEDIUM.sample(rng).astype(np.float64), DECIMALS))


def other_theta(rng: np.random.Generator) -> np.ndarray:
    """Return a random task (8,) with a theta of the hard space outside the medium one."""
    while True:
        task = HARD.clip(np.round(HARD.sample(rng).astype(np.float64), DECIMALS))
        if not MEDIUM.contains(task):
            return task


def other_delta(rng: np.random.Generator) -> np.ndarray:
    """Return a random task (8,) of the medium space with another delta."""
    task = inside(rng)
    task[-1] = np.round(rng.uniform(*DELTA), 1)
    return other_delta(rng) if task[-1] == 10 else task


SOURCES: tuple[tuple[str, Draw, tuple[int, int, int]], ...] = (
    ("medium space", inside, (20, 20, 20)),
    ("other theta", other_theta, (7, 7, 6)),
    ("other delta", other_delta, (6, 7, 7)),
)
"""Sources of tasks, with their numbers of easy, medium and hard ones."""


def judge(task: np.ndarray, body_type: str, cppn: CPPN) -> float:
    """Return the difficulty of a task (8,), infinite if it is not feasible."""
    # Only the heights of creepers are random, which do not affect the demands.
    return difficulty(demands(parkour(task, np.random.default_rng(0), cppn=cppn), body_type))


def thirds(body_type: str, cppn: CPPN, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return the terciles (2,) of difficulty of feasible tasks in the medium space, and their share."""
    values = np.array([judge(inside(rng), body_type, cppn) for _ in range(REFERENCE_TASKS)])
    feasible = values[np.isfinite(values)]
    return np.quantile(feasible, [1 / 3, 2 / 3]), len(feasible) / len(values)


def choose(
    draw: Draw,
    quotas: tuple[int, ...],
    rate: Callable[[np.ndarray], float],
    cuts: np.ndarray,
    rng: np.random.Generator,
) -> tuple[list[tuple[float, np.ndarray]], float]:
    """Return `quotas` tasks of each third as (difficulty, task), and the share of feasible tasks."""
    found: list[list[tuple[float, np.ndarray]]] = [[] for _ in quotas]
    drawn = feasible = 0
    while any(len(tasks) < quota for tasks, quota in zip(found, quotas, strict=True)):
        task = draw(rng)
        value = rate(task)
        drawn += 1
        if np.isfinite(value):
            feasible += 1
            third = int(np.searchsorted(cuts, value))
            if len(found[third]) < quotas[third]:
                found[third].append((value, task))
    chosen = [pair for tasks in found for pair in tasks]
    return sorted(chosen, key=lambda pair: pair[0]), feasible / drawn


def make(name: str, seed: int, cppn: CPPN) -> TestSet:
    """Return the test set of a body type, sorted by source (medium space first) and difficulty."""
    body_type, rng = BODY_TYPES[name], np.random.default_rng(seed)
    cuts, share = thirds(body_type, cppn, rng)
    print(f"{name}: thirds cut at {cuts.round(3).tolist()}; {share:.1%} of the medium space are feasible")
    tasks: list[np.ndarray] = []
    for source, draw, quotas in SOURCES:
        chosen, share = choose(draw, quotas, lambda task: judge(task, body_type, cppn), cuts, rng)
        print(f"  {source}: {share:.2%} of its tasks are feasible")
        tasks += [task for _, task in chosen]
    return TestSet(f"parkour_{name}", MEDIUM.names, np.array(tasks, dtype=np.float32))


def main() -> None:
    """Write the files of the three test sets."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("tma_ray/benchmark/test_sets"))
    options = parser.parse_args()
    cppn = CPPN.load()
    for seed, name in enumerate(BODY_TYPES):
        test_set = make(name, seed, cppn)
        (options.output / f"{test_set.name}.csv").write_text(test_set.to_csv())


if __name__ == "__main__":
    main()
