"""The conformance kit's checks of single tasks and log rows; each raises an AssertionError."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from tma_ray.tasks import TaskSpace, TeacherUpdate


def check_tasks(tasks: Iterable[Any], space: TaskSpace, name: str) -> None:
    """Refuses all but float32 tasks inside `space`."""
    for task in tasks:
        assert isinstance(task, np.ndarray), f"{name} gave {task!r}; expected a numpy array"
        assert task.dtype == np.float32, f"{name} gave {task.dtype} tasks; expected float32 (space.clip)"
        assert task.shape == (space.size,), f"{name} gave shape {task.shape}; expected ({space.size},)"
        assert space.contains(task), (
            f"{name} left its space with {task.tolist()}: bounds are {space.low.tolist()} to "
            f"{space.high.tolist()}; clip with space.clip"
        )


def check_update(update: TeacherUpdate, space: TaskSpace, name: str) -> None:
    """Refuses a log row that does not fit `space`, or cannot be drawn."""
    square = (space.size, space.size)
    for part in update.gaussians:
        assert np.shape(part.mean) == (space.size,), f"{name} logs a mean of shape {np.shape(part.mean)}"
        assert np.shape(part.covariance) == square, (
            f"{name} logs a covariance of shape {np.shape(part.covariance)}; expected {square}"
        )
        numbers = [part.weight, *np.ravel(part.mean), *np.ravel(part.covariance)]
        assert np.all(np.isfinite(numbers)), f"{name} logs a Gaussian that is not finite: {part}"
        assert part.weight >= 0, f"{name} logs a Gaussian of negative weight: {part}"
        assert np.allclose(part.covariance, np.transpose(part.covariance)), (
            f"{name} logs an asymmetric {part}"
        )
        assert np.all(np.linalg.eigvalsh(part.covariance) > 0), (
            f"{name} logs a covariance that is not positive definite: {part.covariance}"
        )
    for box in update.boxes:
        assert np.shape(box.low) == np.shape(box.high) == (space.size,), f"{name} logs a misshapen {box}"
        numbers = [box.score, *box.low, *box.high]
        assert np.all(np.isfinite(numbers)), f"{name} logs a box that is not finite: {box}"
        assert np.all(np.asarray(box.low) <= np.asarray(box.high)), f"{name} logs a box upside down: {box}"
    for key, value in update.scalars.items():
        assert np.isfinite(value), f"{name} logs {key} = {value}; expected a finite number"


def first_difference(first: Iterable[Any], second: Iterable[Any]) -> int | None:
    """Returns the index of the first task in which two plays differ, None if they do not."""
    for index, (one, other) in enumerate(zip(first, second, strict=True)):
        if not np.array_equal(one, other):
            return index
    return None
