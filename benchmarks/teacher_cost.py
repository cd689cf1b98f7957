"""Cost of a teacher per episode: time in `observe`, `answer` and `sample`, early and late in training.

    python benchmarks/teacher_cost.py --episodes 40000 --teachers spdl goal_gan --output teacher_cost.json
    python benchmarks/teacher_cost.py --episodes 12000 --csv benchmarks/measured/teacher_cost.csv

Returns follow a formula instead of a student; episodes last 350 to 830 steps. If late episodes cost much more
than early ones, the cost grows with the teacher's history. Times are processor times, which depend less on
other processes of the machine.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tma_ray.benchmark import find_challenge
from tma_ray.tasks import Episode, KnowledgeLevel, Outcomes, Task, expert_knowledge
from tma_ray.teachers import TEACHERS, make_teacher
from tma_ray.testing.students import report_episode

SHARE = 0.25

PRESETS = "goal_gan:preset=release", "setter_solver:preset=release", "spdl:preset=release"
"""Teachers of releases with settings other than the defaults."""


def cost(name: str, episodes: int) -> dict[str, float | str]:
    """Return the milliseconds per episode: over all episodes, the first and the last quarter."""
    challenge = find_challenge("stump_tracks", "original")
    space = challenge.task_space
    teacher = make_teacher(name)
    placement = np.random.default_rng(0)
    knowledge = expert_knowledge(KnowledgeLevel.HIGH, space, placement, challenge.easy_task)
    teacher.start(space, knowledge, np.random.default_rng(0))
    noise = np.random.default_rng(1).normal(0, 80, episodes)
    spent, step = np.empty(episodes), 0
    for index in range(episodes):
        start = time.process_time()
        task = teacher.propose().task
        spent[index] = time.process_time() - start
        skill = 3 * index / episodes
        episodic_return = float(np.clip(300 - 150 * (float(task[0]) - skill) + noise[index], -150, 330))
        length = int(500 + episodic_return)
        step += length
        episode = played(task, episodic_return, length, step)
        start = time.process_time()
        report_episode(teacher, episode, values, evaluated)
        spent[index] += time.process_time() - start
        teacher.drain_updates()
    quarter = int(SHARE * episodes)
    first, last = spent[:quarter].mean(), spent[-quarter:].mean()
    return {
        "teacher": name,
        "milliseconds": 1e3 * spent.mean(),
        "first_quarter": 1e3 * first,
        "last_quarter": 1e3 * last,
        "ratio_last_to_first": last / first,
    }


def played(task: Task, episodic_return: float, length: int, step: int) -> Episode:
    """Return an episode with the given result."""
    observation = np.zeros(24, dtype=np.float32)
    observation[: len(task)] = task
    success, discounted_return = episodic_return > 230, episodic_return / 6
    return Episode(task, episodic_return, success, length, observation, discounted_return, step)


def values(observations: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return state values (n,) of observations (n, o), higher for lower stumps."""
    return 50 - 10 * observations[:, 0].astype(np.float64)


def evaluated(tasks: Task, _greedy: bool) -> Outcomes:
    """Return the outcomes of tasks (n, d), mastered if stumps are low."""
    episodic_returns = 300 - 100 * tasks[:, 0].astype(np.float64)
    return Outcomes(episodic_returns, episodic_returns > 230, np.full(len(tasks), 500))


def main() -> None:
    """Measure all teachers of the catalogue, or the requested ones."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--episodes", type=int, default=40_000, help="of each teacher (%(default)s)")
    parser.add_argument("--teachers", nargs="+", default=[*TEACHERS.names(), *PRESETS])
    parser.add_argument("--output", type=Path)
    parser.add_argument("--csv", type=Path, help="table of docs/teachers.md")
    options = parser.parse_args()
    rows = [cost(name, options.episodes) for name in options.teachers]
    for row in rows:
        print(json.dumps(row))
    if options.output:
        options.output.write_text(json.dumps({"machine": platform.machine(), "rows": rows}, indent=1))
    if options.csv:
        table = pd.DataFrame(rows).sort_values("milliseconds", ignore_index=True).round(3)
        table["ratio_last_to_first"] = table["ratio_last_to_first"].round(1)
        columns = {"milliseconds": "ms an episode", "ratio_last_to_first": "last quarter to first"}
        table[["teacher", *columns]].rename(columns=columns).to_csv(options.csv, index=False)


if __name__ == "__main__":
    main()
