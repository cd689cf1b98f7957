"""Time of an environment's step and reset with both engines, and of the bare simulation of a step.

Prints a line per task and writes JSON. Only ratios carry over to other machines: all variants are measured in
turn within one run, by processor time.

    python benchmarks/env_step.py --steps 20000 --output env_step.json
    python benchmarks/env_step.py --environments parkour --bodies classic_bipedal fish climbing_chimpanzee
    python benchmarks/env_step.py --environments stump_tracks --bodies classic_bipedal --box2d
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import gymnasium
import numba
import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import embodiment_names
from tma_ray.envs.base import BodyEnvironment
from tma_ray.envs.parkour import Parkour
from tma_ray.envs.stump_tracks import StumpTracks
from tma_ray.physics import PHYSICS_VERSION
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.compiled.step import (
    COUNT_CONTACT,
    DURATION,
    MOTOR_SUBSTEPS,
    SUBSTEPS,
    Floats,
    Integers,
    advance,
    body_in,
    simulation_in,
)
from tma_ray.physics.kernels import command_motors
from tma_ray.physics.pymunk_engine import PymunkEngine

Tasks = dict[str, list[float]]
STUMPS: Tasks = {"flat": [0.0, 6.0], "usual": [1.5, 3.0], "crowded": [1.5, 0.0]}
TERRAINS: Tasks = {
    medium: [-0.1, 0.9, 0.1, water, 0.25, 2.0, 2.0, 10.0] for medium, water in (("dry", 0.0), ("wet", 1.0))
}
WORLDS: dict[str, tuple[type[StumpTracks | Parkour], Tasks]] = {
    "stump_tracks": (StumpTracks, STUMPS),
    "parkour": (Parkour, TERRAINS),
}
ENGINES: dict[str, type[CompiledEngine | PymunkEngine]] = {"compiled": CompiledEngine, "pymunk": PymunkEngine}
BODIES = ["classic_bipedal", "fish", "climbing_chimpanzee"]
RESETS = 100


Actions = NDArray[np.float32]


def simulate(floats: Floats, integers: Integers, actions: Actions) -> None:
    """Play `actions` in Chipmunk alone: set the motors and advance the simulation."""
    body, simulation = body_in(floats, integers), simulation_in(floats, integers)
    substeps, motor_substeps = integers[SUBSTEPS], integers[MOTOR_SUBSTEPS]
    for action in actions:
        simulation.action[:] = action
        command_motors(simulation.action, True, body, simulation.commands)
        advance(simulation, substeps, motor_substeps, floats[DURATION], integers[COUNT_CONTACT])


# Not cached on disk, since the cache would not notice changes of the kernels that are called.
compiled_simulate: Any = numba.njit(simulate)


def seconds(function: Callable[[], object]) -> float:
    """Return the processor time of a call of `function`, in s."""
    start = time.process_time()
    function()
    return time.process_time() - start


def environment(world: str, body: str, engine: str) -> BodyEnvironment:
    """Return an environment with the named engine instead of the default."""
    env = WORLDS[world][0](embodiment=body)
    env._engine = ENGINES[engine](env.embodiment, env.rules)
    return env


def play(env: gymnasium.Env[Any, Any], task: list[float], actions: Actions) -> list[int]:
    """Play `actions` over one episode after another; return the lengths of the episodes."""
    lengths = [0]
    env.reset(seed=0, options={"task": task})
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        lengths[-1] += 1
        if terminated or truncated:
            env.reset(options={"task": task})
            lengths.append(0)
    return lengths


def bare_seconds(env: BodyEnvironment, task: list[float], actions: Actions, lengths: list[int]) -> float:
    """Return the time of the same episodes in Chipmunk alone, one compiled loop per episode, in s."""
    total, start = 0.0, 0
    for episode, length in enumerate(lengths):
        env.reset(seed=None if episode else 0, options={"task": task})
        memory = cast("CompiledEngine", env._engine)._memory
        total += seconds(partial(compiled_simulate, *memory, actions[start : start + length]))
        start += length
    return total


def reset_seconds(env: BodyEnvironment, task: list[float]) -> float:
    """Return the mean time of a reset, in s."""
    return seconds(lambda: [env.reset(options={"task": task}) for _ in range(RESETS)]) / RESETS


def measure(world: str, body: str, task: list[float], steps: int, box2d: bool) -> dict[str, float]:
    """Return the times of steps (including resets), of resets, and of the simulation in a step, in µs.

    Parkour has no time of the bare simulation, since forces of water and grips are computed outside of it.
    With `box2d`, Gymnasium's walker plays a tenth of the steps, also without wrappers.
    """
    envs = {engine: environment(world, body, engine) for engine in ENGINES}
    shape = steps, envs["compiled"].embodiment.action_size
    actions = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    figures: dict[str, float] = {}
    for engine, env in envs.items():
        figures[f"{engine}_step_us"] = seconds(partial(play, env, task, actions)) / steps * 1e6
        figures[f"{engine}_reset_us"] = reset_seconds(env, task) * 1e6
    if world == "stump_tracks":
        lengths = play(envs["compiled"], task, actions)
        bare = bare_seconds(envs["compiled"], task, actions, lengths) / steps * 1e6
        figures["bare_simulation_us"] = bare
        figures["compiled_to_bare"] = figures["compiled_step_us"] / bare
    if box2d:
        walker, few = gymnasium.make("BipedalWalker-v3").unwrapped, max(1, steps // 10)
        walking = np.random.default_rng(0).uniform(-1, 1, (few, 4)).astype(np.float32)
        figures["box2d_step_us"] = seconds(partial(play, walker, task, walking)) / few * 1e6
        figures["box2d_to_compiled"] = figures["box2d_step_us"] / figures["compiled_step_us"]
    figures["pymunk_to_compiled"] = figures["pymunk_step_us"] / figures["compiled_step_us"]
    figures["pymunk_to_compiled_reset"] = figures["pymunk_reset_us"] / figures["compiled_reset_us"]
    figures["steps_per_second"] = 1e6 / figures["compiled_step_us"]
    return figures


def main() -> None:
    """Measure all chosen bodies on all tasks of the chosen environments."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="steps per task and repeat")
    parser.add_argument("--repeats", type=int, default=3, help="repeats, of which the median counts")
    parser.add_argument("--environments", nargs="+", choices=WORLDS, default=list(WORLDS))
    parser.add_argument("--bodies", nargs="+", choices=embodiment_names(), default=BODIES)
    parser.add_argument("--box2d", action="store_true", help="also Gymnasium's BipedalWalker-v3")
    parser.add_argument("--output", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    results: dict[str, dict[str, float]] = {}
    for world, body in itertools.product(arguments.environments, arguments.bodies):
        for name, task in WORLDS[world][1].items():
            measured = partial(measure, world, body, task, box2d=arguments.box2d)
            measured(min(100, arguments.steps))  # compiles the kernels
            repeats = [measured(arguments.steps) for _ in range(arguments.repeats)]
            row = {key: statistics.median(repeat[key] for repeat in repeats) for key in repeats[0]}
            results[f"{world}, {body}, {name}"] = row
            figures = ", ".join(f"{key} {value:.4g}" for key, value in row.items())
            print(f"{world}, {body}, {name}: {figures}", flush=True)
    if arguments.output:
        about = {"physics_version": PHYSICS_VERSION, "machine": platform.machine(), "steps": arguments.steps}
        arguments.output.write_text(json.dumps(about | {"results": results}, indent=2) + "\n")


if __name__ == "__main__":
    main()
