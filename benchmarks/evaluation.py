"""Speed of an evaluation: all tasks of the test set in lock-step, against one task after the other.

    python benchmarks/evaluation.py --output evaluation.json

Trains PPO on easy tasks until it walks, which takes a minute or two, and evaluates it on the 100 test tasks
of Stump Tracks in both ways alternately. Times are processor times.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from tma_ray.benchmark import find_challenge
from tma_ray.envs import make_environment
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.inputs import arguments
from tma_ray.runs.spec import evaluation_seeds
from tma_ray.students import Student, Transition, make_student
from tma_ray.students.base import Actions, Observations


def walker(steps: int) -> Student:
    """Return a PPO student after `steps` steps on easy tasks."""
    environment, tasks = make_environment("stump_tracks"), find_challenge("stump_tracks", "easy").task_space
    spaces = environment.observation_space, environment.action_space
    student, rng = make_student("ppo", *spaces, np.random.SeedSequence(0)), np.random.default_rng(0)
    observation, _ = environment.reset(seed=0, options={"task": tasks.sample(rng)})
    for _ in range(steps):
        action = student.act(observation)
        following, reward, terminated, truncated, _ = environment.step(action)
        student.observe(Transition(observation, action, float(reward), following, terminated, truncated))
        observation = following
        if terminated or truncated:
            observation, _ = environment.reset(options={"task": tasks.sample(rng)})
    return student


class Timed:
    """Student with a measurement of the time spent acting."""

    def __init__(self, student: Student) -> None:
        self.student, self.seconds = student, 0.0

    def act_greedily(self, observations: Observations) -> Actions:
        """Return the student's actions, and measure the time."""
        start = time.process_time()
        actions = self.student.act_greedily(observations)
        self.seconds += time.process_time() - start
        return actions


def in_lock_step(evaluation: Evaluation, student: Student) -> dict[str, float]:
    """Play the test set in lock-step; return steps, mean return, and microseconds per step."""
    timed = Timed(student)
    start = time.process_time()
    rows = evaluation(timed.act_greedily)
    seconds = time.process_time() - start
    steps = sum(row["length"] for row in rows)
    return {
        "steps": steps,
        "mean_return": float(np.mean([row["episodic_return"] for row in rows])),
        "microseconds": 1e6 * seconds / steps,
        "acting_microseconds": 1e6 * timed.seconds / steps,
    }


def one_by_one(spec: RunSpec, student: Student) -> dict[str, float]:
    """Play a tenth of the test set, one task after the other; return microseconds per step."""
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    steps, start = 0, time.process_time()
    for index, seed in list(enumerate(evaluation_seeds(spec.test_set)))[::10]:
        observation, _ = environment.reset(seed=seed, options={"task": spec.test_set.tasks[index]})
        over = False
        while not over:
            action = student.act_greedily(observation[None])[0]
            observation, _, terminated, truncated, _ = environment.step(action)
            over, steps = terminated or truncated, steps + 1
    return {"steps": steps, "microseconds": 1e6 * (time.process_time() - start) / steps}


def measure(student: Student, repeats: int) -> dict[str, Any]:
    """Return medians over `repeats` turns, after a warm-up turn."""
    spec = effective_spec(Cell(student="ppo"), 0, Schedule())
    evaluation = Evaluation(spec)
    turns = [(in_lock_step(evaluation, student), one_by_one(spec, student)) for _ in range(repeats + 1)][1:]
    together = {key: statistics.median(turn[0][key] for turn in turns) for key in turns[0][0]}
    return {
        "mean_length": together["steps"] / len(spec.test_set),
        "mean_return": together["mean_return"],
        "steps_per_second": 1e6 / together["microseconds"],
        "microseconds": together["microseconds"],
        "acting_microseconds": together["acting_microseconds"],
        "ratio_to_one_by_one": statistics.median(b["microseconds"] / a["microseconds"] for a, b in turns),
    }


def main() -> None:
    """Measure evaluations in lock-step and one by one, in turn."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--training-steps", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    result = {"machine": platform.machine()} | measure(walker(options.training_steps), options.repeats)
    print(json.dumps(result))
    if options.output:
        options.output.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
