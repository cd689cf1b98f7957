"""Speed of vector environments: ours with one and several threads, Gymnasium's, stable-baselines3's.

    python benchmarks/vector_envs.py --output vector_envs.json

Random actions on a task of medium difficulty, with resets at the ends of episodes. Measured alternately, by
the processor time of all processes, and by wall time, which shows the gain from threads, but is unreliable on
a busy machine. Speeds are relative to stable-baselines3's DummyVecEnv in the same turn.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv

import tma_ray  # noqa: F401  (registers the environments)

ID = "tma_ray/StumpTracks-v0"
TASK = np.array([1.5, 3.0])

Actions: TypeAlias = NDArray[np.float32]

Step: TypeAlias = Callable[[Actions], object]
"""Function that steps all environments of a vector with actions (n, a)."""

Maker: TypeAlias = Callable[[int], tuple[Step, Callable[[], None]]]
"""Function that returns functions to step and close a vector of the given number of environments."""


class OnOneTask(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Wrapper that resets an environment to `TASK`."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Reset the environment to `TASK`, overriding the option."""
        return self.env.reset(seed=seed, options={**(options or {}), "task": TASK})


def one() -> gymnasium.Env[Any, Any]:
    """Return a single environment of ours."""
    return OnOneTask(gymnasium.make(ID).unwrapped)


def ours(number: int, threads: int) -> tuple[Step, Callable[[], None]]:
    """Return functions that step and close a vector environment of ours, with manual resets."""
    worlds = gymnasium.make_vec(ID, num_envs=number, threads=threads, autoreset_mode=AutoresetMode.DISABLED)
    tasks = np.tile(TASK, (number, 1))
    worlds.reset(seed=0, options={"task": tasks})

    def step(actions: Actions) -> None:
        *_, terminated, truncated, _ = worlds.step(actions)
        over = terminated | truncated
        if over.any():
            worlds.reset(options={"reset_mask": over, "task": tasks})

    return step, worlds.close


def ours_next_step(number: int) -> tuple[Step, Callable[[], None]]:
    """Return functions that step and close a vector environment of ours, with autoreset."""
    worlds = gymnasium.make_vec(ID, num_envs=number, next_task=lambda: TASK)
    worlds.reset(seed=0)
    return worlds.step, worlds.close


def sb3(number: int) -> tuple[Step, Callable[[], None]]:
    """Return functions that step and close a DummyVecEnv of stable-baselines3."""
    worlds = DummyVecEnv([one] * number)
    worlds.seed(0)
    worlds.reset()
    return worlds.step, worlds.close


def gymnasiums(
    kind: Callable[..., gymnasium.vector.VectorEnv[Any, Any, Any]],
) -> Maker:
    """Return a `Maker` for a type of Gymnasium's vector environments."""

    def make(number: int) -> tuple[Step, Callable[[], None]]:
        worlds = kind([one] * number)
        worlds.reset(seed=0)
        return worlds.step, worlds.close

    return make


REFERENCE = "sb3_dummy"
OTHERS: dict[str, Maker] = {
    "tma_ray_next_step": ours_next_step,
    REFERENCE: sb3,
    "gymnasium_sync": gymnasiums(gymnasium.vector.SyncVectorEnv),
    "gymnasium_async": gymnasiums(gymnasium.vector.AsyncVectorEnv),
}


def processor_seconds() -> float:
    """Return the processor time of this process and of its child processes that have ended, in s."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def microseconds(make: Maker, number: int, steps: int) -> dict[str, float]:
    """Return wall and processor time per step of one environment, in µs."""
    rng, before_start = np.random.default_rng(0), processor_seconds()
    step, close = make(number)
    shape = (number, *(gymnasium.make(ID).action_space.shape or ()))
    actions = rng.uniform(-1, 1, (100, *shape)).astype(np.float32)
    for index in range(20):
        step(actions[index])
    begun, start = processor_seconds() - before_start, time.perf_counter()
    for index in range(steps // number):
        step(actions[index % 100])
    wall = time.perf_counter() - start
    close()
    spent = processor_seconds() - before_start - begun
    return {"wall": 1e6 * wall / steps, "processor": 1e6 * spent / steps}


def measure(number: int, threads: list[int], steps: int, repeats: int) -> dict[str, Any]:
    """Return the median times and relative speeds of all vector environments over `repeats` turns."""
    mine = {f"tma_ray_{count}": partial(ours, threads=count) for count in threads if count <= number}
    kinds: dict[str, Maker] = {**mine, **OTHERS}
    turns = [{kind: microseconds(kinds[kind], number, steps) for kind in kinds} for _ in range(repeats)]
    result: dict[str, Any] = {}
    for clock in ("processor", "wall"):
        result[f"{clock}_microseconds"] = {
            kind: round(statistics.median(turn[kind][clock] for turn in turns), 1) for kind in kinds
        }
        result[f"{clock}_speed"] = {
            kind: round(statistics.median(turn[REFERENCE][clock] / turn[kind][clock] for turn in turns), 2)
            for kind in kinds
        }
    return result


def main() -> None:
    """Measure vector environments of several sizes."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument(
        "--numbers", type=int, nargs="+", default=[1, 4, 8, 16, 64], help="environments in a vector"
    )
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="numbers of threads of ours")
    parser.add_argument("--steps", type=int, default=100_000, help="of all environments together")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"machine": platform.machine()}
    for number in options.numbers:
        result[str(number)] = measure(number, options.threads, options.steps, options.repeats)
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
