"""Synthetic curricula of all kinds of teachers, over task spaces of any dimension."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.curricula import Axis, RunCurriculum

STEPS = 20_000_000
PROBE_EVERY = 250_000
UNITS = ("m", "terrain steps", "", "rad", "%")
Update = dict[str, Any]


def axes(size: int) -> tuple[Axis, ...]:
    """Return `size` task dimensions with different ranges, the fourth one constant."""
    named = (f"Dimension {i}" + (f" ({UNITS[i % 5]})" if UNITS[i % 5] else "") for i in range(size))
    return tuple(Axis(name, -i, -i if i == 3 else 3.0 + i) for i, name in enumerate(named))


def curriculum(teacher: str, size: int = 2, upto: float = 1.0) -> RunCurriculum:
    """Return a synthetic curriculum of a teacher after a share `upto` of the steps."""
    rng = np.random.default_rng([*teacher.encode(), size])
    low, high = (np.array([getattr(axis, name) for axis in axes(size)]) for name in ("low", "high"))
    steps = range(0, int(upto * STEPS) + 1, PROBE_EVERY)
    update = KINDS[teacher]
    updates = [{"step": s, **EMPTY, **update(s / STEPS, low, high, rng)} for s in steps if s and update]
    probes = [{"step": s, "task": t} for s in steps for t in _probed(teacher, s / STEPS, low, high, rng)]
    tasks = _probed("random", 0, low, high, rng, 400)
    episodes = pd.DataFrame({"step": np.linspace(1, upto * STEPS, 400), "task": list(tasks)})
    episodes = episodes.assign(world_task=None, episodic_return=np.linspace(-150, 320, 400))
    columns = ["step", *EMPTY]
    return RunCurriculum(episodes, pd.DataFrame(probes), pd.DataFrame(updates, columns=columns), STEPS)


def _frontier(time: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return low + (high - low) * (0.15 + 0.65 * time)


def _probed(
    teacher: str, time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator, count: int = 100
) -> np.ndarray:
    spread = np.inf if teacher == "random" or (teacher == "alp_gmm" and not time) else 0.05 + 0.1 * time
    if not np.isfinite(spread):
        return rng.uniform(low, high, (count, len(low))).astype(np.float32)
    drawn = rng.normal(_frontier(time, low, high), spread * (high - low), (count, len(low)))
    return np.clip(drawn, low, high).astype(np.float32)


def _mixture(time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Update:
    weights = rng.dirichlet(np.ones(5))
    means = rng.normal(_frontier(time, low, high), 0.15 * (high - low), (5, len(low)))
    turns = rng.normal(size=(5, len(low), len(low))) * 0.08 * (high - low)[:, None]
    parts = zip(weights, means, turns @ turns.transpose(0, 2, 1), strict=True)
    gaussians = [{"weight": w, "mean": m, "covariance": c.tolist()} for w, m, c in parts]
    components, progress = float(rng.integers(2, 11)), 40 * np.exp(-time) + rng.normal(0, 4)
    scalars = [("components", components), ("mean_absolute_learning_progress", progress)]
    return {"gaussians": gaussians, "scalars": scalars}


def _gaussian(time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Update:
    deviations = (0.08 + 0.2 * time) * (high - low)
    mean = _frontier(time, low, high)
    one = {"weight": 1.0, "mean": mean, "covariance": np.diag(deviations**2).tolist()}
    scalars = [("alpha", 1e-4 * np.exp(8 * time)), ("kl_to_target", 9 - 8 * time)]
    return {"gaussians": [one], "scalars": scalars}


def _box(time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Update:
    centre, share = low + 0.2 * (high - low), min(1, 0.05 + time)
    low_end, high_end = (centre + share * (end - centre) for end in (low, high))
    box = {"low": low_end, "high": high_end, "score": 0.0}
    return {"boxes": [box], "scalars": [("share_of_space", share ** len(low))]}


def _regions(time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Update:
    boxes = [(low.copy(), high.copy())]
    for cut in range(int(40 * time) + 1):
        lower, upper = boxes.pop(int(rng.integers(len(boxes))))
        left, right = (lower.copy(), upper.copy()), (lower.copy(), upper.copy())
        dimension = cut % len(low)
        at = rng.uniform(0.35, 0.65) * (upper - lower)[dimension] + lower[dimension]
        left[1][dimension] = right[0][dimension] = at
        boxes += [left, right]
    frontier = _frontier(time, low, high)
    scores = [60 * np.exp(-3 * np.linalg.norm((lo + hi) / 2 - frontier) / 3) for lo, hi in boxes]
    scored = zip(boxes, scores, strict=True)
    shown = [{"low": low, "high": high, "score": score} for (low, high), score in scored]
    return {"boxes": shown, "scalars": [("regions", float(len(boxes)))]}


def _losses(time: float, low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Update:
    names = ("judge_loss", "validity_loss", "feasibility_loss", "coverage_loss")
    return {"scalars": [(n, np.exp(-2 * time) + rng.normal(0, 0.05) * i) for i, n in enumerate(names, 1)]}


EMPTY: Update = {"gaussians": [], "boxes": [], "scalars": []}

KINDS: dict[str, Callable[..., Update] | None] = {
    "random": None,
    **dict.fromkeys(("alp_gmm", "covar_gmm"), _mixture),
    "spdl": _gaussian,
    "adr": _box,
    "riac": _regions,
    **dict.fromkeys(("goal_gan", "setter_solver"), _losses),
}
