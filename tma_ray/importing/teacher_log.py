"""Rows of our teacher log from the records of the original's teachers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.importing.rows import episode_ends
from tma_ray.importing.seeds import ImportedSeed
from tma_ray.importing.teacher_history import Floats, in_proportion, matrix, vector
from tma_ray.results.rows import teacher_log_row
from tma_ray.tasks import ScoredBox, TeacherUpdate, WeightedGaussian

Update = tuple[float, TeacherUpdate]
"""Time in the clock of the teacher's history, and the update."""

_EPISODES: Final = "episodes"
_LOSSES: Final = {
    "goal_gan": {"dis_log_loss": "discriminator_loss", "gen_log_loss": "generator_loss"},
    "setter_solver": {"judge_loss": "judge_loss", "setter_loss": "setter_loss"},
}
"""Our names of what networks lost, by teacher and the original's name."""


def teacher_rows(seed: ImportedSeed) -> list[dict[str, Any]]:
    """Returns the rows of the teacher log, as far as the history allows; none for a teacher without one.

    Raises:
        ValueError: its history is not one of this teacher; the message says why.
    """
    teacher = seed.folder.setting.teacher
    reader = _READERS.get(teacher)
    if reader is None:
        return []
    ends, last = episode_ends(seed), seed.windows[-1].step
    clock, updates = reader(seed.history.teacher, seed.history.tasks.shape[1])
    rows = []
    for moment, update in updates:
        if clock == _EPISODES:
            episode = int(moment)
            if episode > len(ends):
                break
            step = int(ends[episode - 1]) if episode > 0 else 0
        else:
            step = int(moment)
            episode = int(np.searchsorted(ends, step, side="right"))
        if step <= last:
            rows.append(teacher_log_row(step, max(episode, 0), update))
    return rows


Reader = Callable[[Mapping[str, Any], int], tuple[str, Iterator[Update]]]


def _mixtures(history: Mapping[str, Any], size: int) -> tuple[str, Iterator[Update]]:
    names = ("weights", "means", "covariances")
    fits, moments = _parallel(history, names, _EPISODES), vector(history.get(_EPISODES), _EPISODES)
    return _EPISODES, (
        (moment, TeacherUpdate(gaussians=_gaussians(fit, size), scalars={"components": float(len(fit[0]))}))
        for moment, fit in zip(moments, fits, strict=True)
    )


def _gaussians(fit: Sequence[Any], size: int) -> tuple[WeightedGaussian, ...]:
    """Returns the part of a mixture in the task space, without what was fitted beside tasks."""
    weights = vector(fit[0], "weights")
    means, covariances = (np.asarray(part) if _plain(part, size) else np.zeros(0) for part in fit[1:])
    width = means.shape[-1] if means.ndim == 2 else 0
    if width < size or means.shape[0] != len(weights) or covariances.shape != (len(weights), width, width):
        raise ValueError("weights, means and covariances of a mixture do not fit together")
    return tuple(
        WeightedGaussian(float(w), m[:size].astype(float), c[:size, :size].astype(float))
        for w, m, c in zip(weights, means, covariances, strict=True)
    )


def _plain(value: Any, size: int) -> bool:
    """Tells whether something is an array, or a list of arrays of one shape, a little over `size` long."""
    if isinstance(value, np.ndarray):
        return True
    arrays = isinstance(value, list | tuple) and all(isinstance(each, np.ndarray) for each in value)
    shapes = {each.shape for each in value} if arrays else set()
    return len(shapes) == 1 and max(max(shapes), default=0) <= 2 * size + 2


def _regions(history: Mapping[str, Any], size: int) -> tuple[str, Iterator[Update]]:
    splits, moments = (
        _parallel(history, ("all_boxes", "all_alps"), "split_iterations"),
        history["split_iterations"],
    )
    return _EPISODES, (
        (moment, TeacherUpdate(boxes=_boxes(boxes, vector(alps, "all_alps"), size)))
        for moment, (boxes, alps) in zip(vector(moments, "split_iterations"), splits, strict=True)
    )


def _boxes(boxes: Any, scores: Floats, size: int) -> tuple[ScoredBox, ...]:
    if not isinstance(boxes, list | tuple | np.ndarray) or len(boxes) != len(scores):
        raise ValueError("all_boxes and all_alps do not fit together")
    return tuple(_box(box, score, size) for box, score in zip(boxes, scores, strict=True))


def _box(value: Any, score: float, size: int) -> ScoredBox:
    ends = matrix(value, size)
    if ends is None or len(ends) != 2 or not np.all(ends[0] <= ends[1]):
        raise ValueError("a box is not a pair of lows and highs")
    return ScoredBox(ends[0], ends[1], float(score))


def _one_box(history: Mapping[str, Any], size: int) -> tuple[str, Iterator[Update]]:
    boxes, moments = _parallel(history, ("task_space",), _EPISODES), vector(history.get(_EPISODES), _EPISODES)
    return _EPISODES, (
        (moment, TeacherUpdate(boxes=(_box(box, np.nan, size),)))
        for moment, (box,) in zip(moments, boxes, strict=True)
    )


def _losses(teacher: str) -> Reader:
    names = _LOSSES[teacher]

    def read(history: Mapping[str, Any], _: int) -> tuple[str, Iterator[Update]]:
        losses, moments = (
            _parallel(history, tuple(names), _EPISODES),
            vector(history.get(_EPISODES), _EPISODES),
        )
        return _EPISODES, (
            (moment, TeacherUpdate(scalars=_named(tuple(names.values()), values)))
            for moment, values in zip(moments, losses, strict=True)
        )

    return read


def _one_gaussian(history: Mapping[str, Any], size: int) -> tuple[str, Iterator[Update]]:
    names = ("mean", "covariance", "algo_iterations", "kl")
    parts, moments = _parallel(history, names, "steps"), vector(history.get("steps"), "steps")

    def updates() -> Iterator[Update]:
        for moment, (mean, covariance, iteration, divergence) in zip(moments, parts, strict=True):
            spread = matrix(covariance, size)
            centre = vector(mean, "mean")
            if spread is None or len(spread) != size or len(centre) != size:
                raise ValueError("mean and covariance do not fit together")
            scalars = _named(("iteration", "kl"), (iteration, divergence))
            yield moment, TeacherUpdate((WeightedGaussian(1.0, centre, spread),), scalars=scalars)

    return "steps", updates()


def _named(names: Sequence[str], values: Sequence[Any]) -> dict[str, float]:
    """Returns scalars by name: the mean where a training gives one for each of its iterations."""
    found = {
        name: vector(np.atleast_1d(_array(value)), name) for name, value in zip(names, values, strict=True)
    }
    return {name: float(numbers.mean()) for name, numbers in found.items() if len(numbers)}


def _array(value: Any) -> NDArray[np.float64]:
    if isinstance(value, list | tuple):
        return vector(value, "a scalar")
    if isinstance(value, int | float | np.ndarray):
        return np.asarray(value, dtype=np.float64)
    raise ValueError("a scalar is not a number")


def _parallel(history: Mapping[str, Any], names: tuple[str, ...], moments: str) -> list[tuple[Any, ...]]:
    """Returns the entries of several names at each moment."""
    for name in (*names, moments):
        if not isinstance(history.get(name), list | tuple | np.ndarray):
            raise ValueError(f"{name} is not there, or no list")
        if not in_proportion(history[name]):
            raise ValueError(f"{name} has more entries than a training leads to")
    lengths = {name: len(history[name]) for name in (*names, moments)}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {count:,}" for name, count in lengths.items())
        raise ValueError(f"its entries do not fit together: {told}")
    return list(zip(*(history[name] for name in names), strict=True))


_READERS: Final[Mapping[str, Reader]] = {
    "alp_gmm": _mixtures,
    "covar_gmm": _mixtures,
    "riac": _regions,
    "adr": _one_box,
    "goal_gan": _losses("goal_gan"),
    "setter_solver": _losses("setter_solver"),
    "spdl": _one_gaussian,
}
