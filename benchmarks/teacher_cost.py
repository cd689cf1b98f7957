"""What a teacher costs per episode: `observe` and `sample` over many episodes, early and late.

    python benchmarks/teacher_cost.py --episodes 40000 --output teacher_cost.json

The student is a formula. A teacher whose late episodes cost much more than its early ones grows with its
history.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from pathlib import Path

import numpy as np

from tma_ray.benchmark import find_challenge
from tma_ray.tasks import Episode, KnowledgeLevel, expert_knowledge
from tma_ray.teachers import TEACHERS, make_teacher

SHARE = 0.25


def cost(name: str, episodes: int) -> dict[str, float | str]:
    """Returns milliseconds per episode: over all, over the first and over the last quarter."""
    challenge = find_challenge("stump_tracks", "original")
    space = challenge.task_space
    teacher = make_teacher(name)
    placement = np.random.default_rng(0)
    knowledge = expert_knowledge(KnowledgeLevel.HIGH, space, placement, challenge.easy_task)
    teacher.start(space, knowledge, np.random.default_rng(0))
    noise = np.random.default_rng(1).normal(0, 20, episodes)
    observation = np.zeros(24, dtype=np.float32)
    spent = np.empty(episodes)
    for index in range(episodes):
        start = time.perf_counter()
        task = teacher.sample()
        spent[index] = time.perf_counter() - start
        skill = 3 * index / episodes
        episodic_return = float(np.clip(300 - 150 * (float(task[0]) - skill) + noise[index], -150, 330))
        episode = Episode(task, episodic_return, episodic_return > 230, 500, observation, 50.0, 500 * index)
        start = time.perf_counter()
        teacher.observe(episode)
        spent[index] += time.perf_counter() - start
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


def main() -> None:
    """Measures every teacher of the catalogue."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=40_000)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = [cost(name, options.episodes) for name in TEACHERS.names()]
    for row in rows:
        print(json.dumps(row))
    if options.output:
        options.output.write_text(json.dumps({"machine": platform.machine(), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
