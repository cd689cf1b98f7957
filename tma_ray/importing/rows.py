"""The tables of an imported seed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.importing.seeds import ImportedSeed
from tma_ray.tasks import MASTERY_RETURN

PROBE_INTERVAL = 250_000
"""Environment steps between two probes of the original's teachers."""

Rows = list[dict[str, Any]]


def evaluation_rows(seed: ImportedSeed, test_set: str) -> Iterator[Rows]:
    """Yields the rows of each evaluation."""
    history, tests = seed.history, seed.tests
    tasks = history.test_tasks.astype(np.float32)
    for number, step in enumerate(seed.evaluated):
        first = number * tests
        yield [
            {
                "step": step,
                "test_set": test_set,
                "task_index": index,
                "task": tasks[(first + index) % len(tasks)],
                "episodic_return": float(history.test_episodic_returns[first + index]),
                "length": int(history.test_lengths[first + index]),
            }
            for index in range(tests)
        ]


def episode_rows(seed: ImportedSeed) -> Rows:
    """Returns the rows of the training episodes; the step of one is the sum of all lengths until its end."""
    history, ends = seed.history, episode_ends(seed)
    return [
        {
            "step": int(step),
            "episode": number,
            "task": task,
            "episodic_return": float(episodic_return),
            "length": int(length),
            "success": bool(episodic_return > MASTERY_RETURN),
        }
        for number, (step, task, episodic_return, length) in enumerate(
            zip(
                ends, history.tasks.astype(np.float32), history.episodic_returns, history.lengths, strict=True
            )
        )
    ]


def training_rows(seed: ImportedSeed) -> Rows:
    """Returns the rows of training windows: returns and lengths as published, the rest of their episodes."""
    rows, ends = [], episode_ends(seed)
    first = 0
    for window in seed.windows:
        last = int(np.searchsorted(ends, window.step, side="right"))
        returns = seed.history.episodic_returns[first:last]
        std = window.std_return if np.isfinite(window.std_return) or not len(returns) else returns.std()
        rows.append(
            {
                "step": window.step,
                "episodes": last - first,
                "mean_return": window.mean_return,
                "std_return": float(std),
                "mean_length": window.mean_length,
                "success_share": float(np.mean(returns > MASTERY_RETURN)) if len(returns) else float("nan"),
            }
        )
        first = last
    return rows


def curriculum_rows(seed: ImportedSeed) -> Iterator[Rows]:
    """Yields the rows of each probe; of a teacher that had nothing to tell yet there are none.

    The history does not say when a probe was: probes lie 250,000 steps apart, the last at or before the end.
    """
    samples = seed.history.samples or ()
    whole = seed.windows[-1].step // PROBE_INTERVAL
    first = 0 if len(samples) == whole + 1 else 1
    for number, tasks in enumerate(samples, start=first):
        if number * PROBE_INTERVAL <= seed.windows[-1].step:
            yield [
                {"step": number * PROBE_INTERVAL, "sample": sample, "task": task}
                for sample, task in enumerate(tasks.astype(np.float32))
            ]


def episode_ends(seed: ImportedSeed) -> NDArray[np.int64]:
    """Returns the environment steps until the end of each training episode (n,)."""
    ends: NDArray[np.int64] = np.cumsum(seed.history.lengths).astype(np.int64)
    return ends
