"""Cost of a curriculum: an exchange with its process, and a training step of PPO with a teacher.

    python benchmarks/curriculum.py --output curriculum.json

An exchange is one message each way between a worker process and the process that has the teacher. Training
is stable-baselines3's PPO on Gymnasium's pendulum, without and with a teacher that takes 1 ms an episode,
alternately for short times, since other load of the machine then affects both equally.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import platform
import statistics
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import PPO

from tma_ray.curriculum import Curriculum, SharedCurriculum
from tma_ray.curriculum.episodes import PlayedEpisode
from tma_ray.tasks import Episode, Task
from tma_ray.teachers import Teacher

SPACE = {"mass": (0.5, 2.0), "length": (0.5, 1.5)}
TEACHER_SECONDS = 1e-3  # time of the teacher for each episode, s


class SlowTeacher(Teacher):
    """Teacher of uniform tasks with a slow `observe`."""

    def sample(self) -> Task:
        """Return a uniform task (d,)."""
        return self.space.sample(self.rng)

    def observe(self, episode: Episode) -> None:  # noqa: ARG002
        """Busy-wait for `TEACHER_SECONDS`."""
        end = time.perf_counter() + TEACHER_SECONDS
        while time.perf_counter() < end:
            pass


def exchanges(handle: SharedCurriculum, count: int, results: Any) -> None:
    """Put the times of `count` exchanges (ms) into `results`: half for a task, half for an episode."""
    handle.abandon(handle.begin().number)
    times = []
    for _ in range(count // 2):
        start = time.perf_counter()
        assignment = handle.begin()
        between = time.perf_counter()
        handle.end(PlayedEpisode(assignment.number, 0.0, 0.0, 200, np.zeros(3, np.float32), None))
        times += [between - start, time.perf_counter() - between]
    results.put([1e3 * each for each in times])


def exchange_milliseconds(count: int) -> dict[str, float]:
    """Return median and 99th percentile of the time of an exchange, in ms."""
    context = multiprocessing.get_context("spawn")
    curriculum = Curriculum("random", SPACE, mastery_return=0.0)
    results = context.Queue()
    process = context.Process(target=exchanges, args=(curriculum.shared(), count, results))
    process.start()
    times = results.get()
    process.join()
    return {"median": round(statistics.median(times), 3), "p99": round(float(np.percentile(times, 99)), 3)}


def set_task(environment: Any, task: Mapping[str, float]) -> None:
    """Set the mass and the length of a pendulum."""
    environment.unwrapped.m, environment.unwrapped.l = task["mass"], task["length"]


def step_microseconds(model: PPO) -> float:
    """Return the processor time of a training step, over one rollout and its updates, in µs."""
    start = time.process_time()
    model.learn(model.n_steps, reset_num_timesteps=False)
    return 1e6 * (time.process_time() - start) / model.n_steps


def training_microseconds(turns: int) -> list[tuple[float, float]]:
    """Return the processor times of a training step without and with a teacher, measured in turn, in µs."""
    curriculum = Curriculum(SlowTeacher, SPACE, mastery_return=-300.0)
    alone: Any = gymnasium.make("Pendulum-v1")
    taught = curriculum.wrap(gymnasium.make("Pendulum-v1"), set_task)
    models = [PPO("MlpPolicy", each, n_steps=512, seed=0, device="cpu") for each in (alone, taught)]
    for model in models:
        model.learn(model.n_steps)
    return [(step_microseconds(models[0]), step_microseconds(models[1])) for _ in range(turns)]


def main() -> None:
    """Measure exchanges and training steps."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--exchanges", type=int, default=4_000)
    parser.add_argument("--turns", type=int, default=30, help="turns of 512 training steps, of each")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    turns = training_microseconds(options.turns)
    alone, taught = map(statistics.median, zip(*turns, strict=True))
    result = {
        "machine": platform.machine(),
        "exchange_milliseconds": exchange_milliseconds(options.exchanges),
        "step_microseconds": {"alone": round(alone, 1), "taught": round(taught, 1)},
        "added_percent": round(statistics.median(100 * (after / before - 1) for before, after in turns), 2),
    }
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
