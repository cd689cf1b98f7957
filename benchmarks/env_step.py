"""Speed of an environment's step and reset with both engines, against the bare simulation inside them.

Prints a table and writes JSON. Carry the ratios, not the rates: all are measured in turns in one run.

    python benchmarks/env_step.py --steps 20000 --output env_step.json
    python benchmarks/env_step.py --environments parkour --bodies classic_bipedal fish climbing_chimpanzee
"""

from __future__ import annotations

import argparse
import itertools
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tma_ray.embodiments import embodiment_names
from tma_ray.envs.body_environment import BodyEnvironment
from tma_ray.envs.parkour import Parkour
from tma_ray.envs.stump_tracks import StumpTracks
from tma_ray.jit import kernel
from tma_ray.physics import PHYSICS_VERSION, Engine
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.compiled.memory import COUNT_CONTACT, DURATION, SUBSTEPS, body_in, simulation_in
from tma_ray.physics.compiled.step import advance
from tma_ray.physics.kernels import command_motors
from tma_ray.physics.pymunk_engine import PymunkEngine

Tasks = dict[str, list[float]]
STUMPS: Tasks = {"flat": [0.0, 6.0], "usual": [1.5, 3.0], "crowded": [1.5, 0.0]}
TERRAINS: Tasks = {
    medium: [-0.1, 0.9, 0.1, water, 0.25, 2.0, 2.0, 10.0] for medium, water in (("dry", 0.0), ("wet", 1.0))
}
WORLDS: dict[str, tuple[type[BodyEnvironment], Tasks]] = {
    "stump_tracks": (StumpTracks, STUMPS),
    "parkour": (Parkour, TERRAINS),
}
ENGINES: dict[str, type[Engine]] = {"compiled": CompiledEngine, "pymunk": PymunkEngine}
BODIES = ["classic_bipedal", "fish", "climbing_chimpanzee"]
RESETS = 100


@kernel
def simulate(floats, integers, actions):  # noqa: D103
    body, simulation = body_in(floats, integers), simulation_in(floats, integers)
    for action in actions:
        simulation.action[:] = action
        command_motors(simulation.action, True, body, simulation.commands)
        advance(simulation, integers[SUBSTEPS], floats[DURATION], integers[COUNT_CONTACT])


def seconds(function: Callable[[], object]) -> float:
    """Returns the processor's time that `function` takes."""
    start = time.process_time()
    function()
    return time.process_time() - start


def environment(world: str, body: str, engine: str) -> BodyEnvironment:
    """Returns an environment with that engine."""
    env = WORLDS[world][0](embodiment=body)
    env._engine = ENGINES[engine](env.embodiment, env.rules)
    return env


def play(env: BodyEnvironment, task: list[float], actions: np.ndarray) -> list[int]:
    """Plays `actions` in as many episodes as it takes and returns the episodes' lengths."""
    lengths = [0]
    env.reset(seed=0, options={"task": task})
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        lengths[-1] += 1
        if terminated or truncated:
            env.reset(options={"task": task})
            lengths.append(0)
    return lengths


def bare_seconds(env: BodyEnvironment, task: list[float], actions: np.ndarray, lengths: list[int]) -> float:
    """Returns the time of the same episodes in Chipmunk alone, in one compiled loop each."""
    total, start = 0.0, 0
    for episode, length in enumerate(lengths):
        env.reset(seed=None if episode else 0, options={"task": task})
        memory = env._engine._memory
        chosen = actions[start : start + length]
        total += seconds(lambda memory=memory, chosen=chosen: simulate(*memory, chosen))
        start += length
    return total


def reset_seconds(env: BodyEnvironment, task: list[float]) -> float:
    """Returns the time of one reset."""
    return seconds(lambda: [env.reset(options={"task": task}) for _ in range(RESETS)]) / RESETS


def measure(world: str, body: str, task: list[float], steps: int) -> dict[str, float]:
    """Returns microseconds of steps (resets included), of resets, and of the simulation in a step.

    In Parkour the latter is left out: forces of water and grips are not of the simulation alone.
    """
    envs = {engine: environment(world, body, engine) for engine in ENGINES}
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, *envs["compiled"].action_space.shape))
    actions = actions.astype(np.float32)
    figures: dict[str, float] = {}
    for engine, env in envs.items():
        figures[f"{engine}_step_us"] = seconds(lambda env=env: play(env, task, actions)) / steps * 1e6
        figures[f"{engine}_reset_us"] = reset_seconds(env, task) * 1e6
    if world == "stump_tracks":
        lengths = play(envs["compiled"], task, actions)
        bare = bare_seconds(envs["compiled"], task, actions, lengths) / steps * 1e6
        figures["bare_simulation_us"] = bare
        figures["compiled_to_bare"] = figures["compiled_step_us"] / bare
    figures["pymunk_to_compiled"] = figures["pymunk_step_us"] / figures["compiled_step_us"]
    figures["pymunk_to_compiled_reset"] = figures["pymunk_reset_us"] / figures["compiled_reset_us"]
    figures["steps_per_second"] = 1e6 / figures["compiled_step_us"]
    return figures


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20_000, help="steps per task and repeat")
    parser.add_argument("--repeats", type=int, default=3, help="repeats, of which the median counts")
    parser.add_argument("--environments", nargs="+", choices=WORLDS, default=list(WORLDS))
    parser.add_argument("--bodies", nargs="+", choices=embodiment_names(), default=BODIES)
    parser.add_argument("--output", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    results: dict[str, dict[str, float]] = {}
    for world, body in itertools.product(arguments.environments, arguments.bodies):
        for name, task in WORLDS[world][1].items():
            measure(world, body, task, 100)  # compiles
            repeats = [measure(world, body, task, arguments.steps) for _ in range(arguments.repeats)]
            row = {key: statistics.median(repeat[key] for repeat in repeats) for key in repeats[0]}
            results[f"{world}, {body}, {name}"] = row
            figures = ", ".join(f"{key} {value:.4g}" for key, value in row.items())
            print(f"{world}, {body}, {name}: {figures}", flush=True)
    if arguments.output:
        about = {"physics_version": PHYSICS_VERSION, "machine": platform.machine(), "steps": arguments.steps}
        arguments.output.write_text(json.dumps(about | {"results": results}, indent=2) + "\n")


if __name__ == "__main__":
    main()
