"""Speed of an environment step, resets included, against the bare simulation inside it.

Prints a table and writes JSON. Carry the ratio, not the rates: both are measured in the same run.

    python benchmarks/env_step.py --steps 20000 --output env_step.json
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from pathlib import Path

import numpy as np

from tma_ray.envs.stump_tracks import LIDAR_ANGLES, StumpTracks
from tma_ray.physics import PHYSICS_VERSION, PymunkEngine

TASKS = {"flat": [0.0, 6.0], "usual": [1.5, 3.0], "crowded": [1.5, 0.0]}


class TimedEngine(PymunkEngine):
    """Adds up the time spent in Chipmunk (`simulating`) and in resets (`resetting`), in s."""

    simulating = 0.0
    resetting = 0.0

    def reset(self, terrain, push):  # noqa: D102
        start = time.perf_counter()
        observation = super().reset(terrain, push)
        self.resetting += time.perf_counter() - start
        return observation

    def _advance(self) -> None:
        start = time.perf_counter()
        super()._advance()
        self.simulating += time.perf_counter() - start


def measure(task: list[float], steps: int) -> dict[str, float]:
    """Returns microseconds per step of random play: in all, in Chipmunk, and in resets."""
    env, rng = StumpTracks(), np.random.default_rng(0)
    engine = env._engine = TimedEngine(env.embodiment, LIDAR_ANGLES)
    actions = rng.uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)
    env.reset(seed=0, options={"task": task})
    engine.simulating = engine.resetting = 0.0
    start = time.perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset(options={"task": task})
    total = time.perf_counter() - start
    scale = 1e6 / steps
    return {
        "step_us": total * scale,
        "space_step_us": engine.simulating * scale,
        "reset_us": engine.resetting * scale,
        "steps_per_second": steps / total,
        "ratio_to_space_step": total / engine.simulating,
    }


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20_000, help="steps per task and repeat")
    parser.add_argument("--repeats", type=int, default=3, help="repeats, of which the median counts")
    parser.add_argument("--output", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    measure(TASKS["usual"], 1000)  # compiles the kernels
    results = {}
    print(f"{'task':<10}{'steps/s':>10}{'step µs':>10}{'Space.step':>12}{'resets':>8}{'ratio':>8}")
    for name, task in TASKS.items():
        repeats = [measure(task, arguments.steps) for _ in range(arguments.repeats)]
        row = {key: statistics.median(repeat[key] for repeat in repeats) for key in repeats[0]}
        results[name] = row
        print(
            f"{name:<10}{row['steps_per_second']:>10.0f}{row['step_us']:>10.1f}{row['space_step_us']:>12.1f}"
            f"{row['reset_us']:>8.1f}{row['ratio_to_space_step']:>8.2f}"
        )
    if arguments.output:
        about = {"physics_version": PHYSICS_VERSION, "machine": platform.machine(), "steps": arguments.steps}
        arguments.output.write_text(json.dumps(about | {"tasks": results}, indent=2) + "\n")


if __name__ == "__main__":
    main()
