"""Cost of a curriculum: an exchange with its process, and the training step of PPO with a teacher.

    python benchmarks/curriculum.py --output curriculum.json

An exchange is one message each way between a worker process and the process that has the teacher. Training
is stable-baselines3's PPO on Gymnasium's pendulum, alone and with a teacher that takes 1 ms an episode.
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
    """Teacher that proposes uniform tasks, and takes its time to observe an episode."""

    def sample(self) -> Task:
        """Return a uniform task (d,)."""
        return self.space.sample(self.rng)

    def observe(self, episode: Episode) -> None:  # noqa: ARG002
        """Spend `TEACHER_SECONDS`."""
        end = time.perf_counter() + TEACHER_SECONDS
        while time.perf_counter() < end:
            pass


def exchanges(handle: SharedCurriculum, count: int, results: Any) -> None:
    """Put the milliseconds of `count` exchanges, half of them for a task and half for an episode."""
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
    """Return median and 99th percentile of an exchange, in ms."""
    context = multiprocessing.get_context("spawn")
    curriculum = Curriculum("random", SPACE, mastery_return=0.0)
    results = context.Queue()
    process = context.Process(target=exchanges, args=(curriculum.shared(), count, results))
    process.start()
    times = results.get()
    process.join()
    return {"median": round(statistics.median(times), 3), "p99": round(float(np.percentile(times, 99)), 3)}


def set_task(environment: Any, task: Mapping[str, float]) -> None:
    """Set mass and length of a pendulum."""
    environment.unwrapped.m, environment.unwrapped.l = task["mass"], task["length"]


def step_microseconds(steps: int, teaches: bool) -> float:
    """Return the processor time of a training step of PPO on the pendulum, in µs."""
    environment: Any = gymnasium.make("Pendulum-v1")
    if teaches:
        curriculum = Curriculum(SlowTeacher, SPACE, mastery_return=-300.0)
        environment = curriculum.wrap(environment, set_task)
    model = PPO("MlpPolicy", environment, n_steps=512, seed=0, device="cpu")
    model.learn(model.n_steps)
    start = time.process_time()
    model.learn(steps)
    return 1e6 * (time.process_time() - start) / steps


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--exchanges", type=int, default=4_000)
    parser.add_argument("--steps", type=int, default=8_192, help="training steps of a turn")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    turns = [
        {teaches: step_microseconds(options.steps, teaches) for teaches in (False, True)}
        for _ in range(options.repeats)
    ]
    alone, taught = (statistics.median(turn[teaches] for turn in turns) for teaches in (False, True))
    result = {
        "machine": platform.machine(),
        "exchange_milliseconds": exchange_milliseconds(options.exchanges),
        "step_microseconds": {"alone": round(alone, 1), "taught": round(taught, 1)},
        "added_percent": round(statistics.median(100 * (turn[True] / turn[False] - 1) for turn in turns), 2),
    }
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
