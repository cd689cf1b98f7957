"""The teacher history of a seed: ``env_params_save.pkl``, read by the restricted unpickler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.importing.errors import DamagedSeedError
from tma_ray.importing.unpickling import load_pickle

DIMENSIONS = {
    "stump_tracks": ("stump_height", "obstacle_spacing"),
    "parkour": (
        *("theta_1", "theta_2", "theta_3", "water_level", "creepers_width", "creepers_height"),
        *("creepers_spacing", "terrain_cppn_scale"),
    ),
}
"""Names of the task dimensions, in the original's order, which is ours."""

MOST_ENTRIES = 5_000_000
"""Of the lists in one entry of a history together; RIAC's regions of 20 million steps are a tenth of that."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TeacherHistory:
    """The teacher history of one seed: n training episodes, k test episodes, tasks of d dimensions.

    Attributes:
        tasks: of the training episodes (n, d).
        episodic_returns: of the same (n,).
        lengths: of the same (n,), environment steps.
        test_tasks: of the test episodes (k, d), or of one evaluation.
        test_episodic_returns: of the test episodes (k,), evaluation after evaluation.
        test_lengths: of the same (k,), environment steps.
        bounds: of the task space (d, 2); empty where they cannot be told.
        samples: probed tasks, an array for each probe; None where there are none or they cannot be
            told.
        teacher: what else it recorded, by name.
    """

    tasks: Floats
    episodic_returns: Floats
    lengths: Floats
    test_tasks: Floats
    test_episodic_returns: Floats
    test_lengths: Floats
    bounds: Floats
    samples: tuple[Floats, ...] | None
    teacher: Mapping[str, Any] = field(repr=False)


def read_teacher_history(path: Path, environment: str, largest_mebibytes: int) -> TeacherHistory:
    """Returns the teacher history of a seed.

    Raises:
        DamagedSeedError: it is missing, may not be read, or its parts do not fit together.
    """
    if not path.exists():
        raise DamagedSeedError(f"{path} is missing: copy it too")
    content = load_pickle(path, largest_mebibytes)
    if not isinstance(content, dict):
        raise DamagedSeedError(f"{path} does not hold a teacher history: copy it again")
    size = len(DIMENSIONS[environment])
    try:
        tasks = vectors(content, "env_params_train", size)
        test_tasks = vectors(content, "env_params_test", size)
        numbers = {
            name: vector(content.get(name), name)
            for name in ("env_train_rewards", "env_train_len", "env_test_rewards", "env_test_len")
        }
        _check(tasks, test_tasks, numbers)
    except ValueError as error:
        raise DamagedSeedError(f"{path}: {error}; copy it again") from error
    return TeacherHistory(
        tasks=tasks,
        episodic_returns=numbers["env_train_rewards"],
        lengths=numbers["env_train_len"],
        test_tasks=test_tasks,
        test_episodic_returns=numbers["env_test_rewards"],
        test_lengths=numbers["env_test_len"],
        bounds=_bounds(content.get("env_param_bounds"), size),
        samples=_samples(content.get("periodical_samples"), size),
        teacher=content,
    )


def vector(value: Any, name: str) -> Floats:
    """Returns a list or array of numbers (n,).

    Raises:
        ValueError: it is something else; the message has `name`.
    """
    if isinstance(value, np.ndarray):
        found = np.asarray(value, dtype=np.float64)
        if found.ndim == 1:
            return found
    elif isinstance(value, list | tuple):
        plain = [_number(each) for each in value]
        if None not in plain:
            return np.array(plain, dtype=np.float64)
    raise ValueError(f"{name} is not a list of numbers")


def _number(value: Any) -> float | None:
    if isinstance(value, np.ndarray) and value.size == 1:
        return float(value.reshape(())[()])
    return float(value) if isinstance(value, int | float) else None


def vectors(content: Mapping[str, Any], name: str, size: int) -> Floats:
    """Returns a list or array of vectors (n, size).

    Raises:
        ValueError: it is something else; the message has `name`.
    """
    found = matrix(content.get(name), size)
    if found is None:
        raise ValueError(f"{name} is not a list of tasks of {size} finite numbers")
    return found


def matrix(value: Any, size: int) -> Floats | None:
    """Returns a list or array of vectors (n, size); None if it is something else."""
    if _is_empty(value):
        return np.zeros((0, size))
    try:
        if isinstance(value, np.ndarray):
            found = np.asarray(value, dtype=np.float64)
        elif isinstance(value, list | tuple) and all(entries(each) == size for each in value):
            found = np.stack([vector(each, "") for each in value])
        else:
            return None
    except ValueError:
        return None
    fits = found.ndim == 2 and found.shape[1] == size and bool(np.all(np.isfinite(found)))
    return found if fits else None


def _is_empty(value: Any) -> bool:
    # Without numpy's size of a list, which copies what a few bytes of a pickle may name again and again.
    if isinstance(value, np.ndarray):
        return value.ndim > 0 and len(value) == 0
    return isinstance(value, list | tuple) and not value


def entries(value: Any) -> int:
    """Returns how many entries a list or array has; 0 for anything else."""
    if isinstance(value, np.ndarray):
        return len(value) if value.ndim else 0
    return len(value) if isinstance(value, list | tuple) else 0


def in_proportion(value: Any) -> bool:
    """Tells whether the lists in a list are together of a size that training can lead to.

    A pickle may name the same long list any number of times, which takes no room until somebody copies it.
    """
    return not isinstance(value, list | tuple) or sum(map(entries, value)) <= MOST_ENTRIES


def _check(tasks: Floats, test_tasks: Floats, numbers: Mapping[str, Floats]) -> None:
    for kind, first in (("train", tasks), ("test", test_tasks)):
        returns, lengths = numbers[f"env_{kind}_rewards"], numbers[f"env_{kind}_len"]
        if len(returns) != len(lengths) or (kind == "train" and len(returns) != len(first)):
            raise ValueError(
                f"it has {len(first):,} tasks, {len(returns):,} returns and {len(lengths):,} lengths of "
                f"{kind}ing episodes"
            )
        if not np.all(np.isfinite(returns)):
            raise ValueError(f"a return of its {kind}ing episodes is not a finite number")
        if not np.all((lengths >= 0) & (lengths <= 2**31 - 1) & (lengths == np.round(lengths))):
            raise ValueError(f"a length of its {kind}ing episodes is not a whole number of steps")


def _bounds(value: Any, size: int) -> Floats:
    """Returns low and high of each dimension; a name may have several dimensions."""
    rows: list[Floats] = []
    for entry in value if isinstance(value, list | tuple) else ():
        if not isinstance(entry, list | tuple) or len(entry) != 2:
            return np.zeros((0, 2))
        found = _pairs(entry[1])
        if found is None:
            return np.zeros((0, 2))
        rows.append(found)
    bounds = np.vstack(rows) if rows else np.zeros((0, 2))
    known = bounds.shape == (size, 2) and bool(np.all(bounds[:, 0] <= bounds[:, 1]))
    return bounds if known else np.zeros((0, 2))


def _pairs(bounds: Any) -> Floats | None:
    """Returns the bounds of one name as pairs (k, 2), from one pair, k pairs, or k lows and k highs."""
    try:
        return vector(bounds, "").reshape(1, 2)
    except ValueError:
        pass
    pairs = matrix(bounds, 2)
    if pairs is not None and len(pairs) != 2:
        return pairs
    ends = matrix(bounds, 3)
    return ends.T if ends is not None and len(ends) == 2 else None


def _samples(value: Any, size: int) -> tuple[Floats, ...] | None:
    if not isinstance(value, list | tuple) or not in_proportion(value):
        return None
    found = [matrix(each, size) for each in value]
    return None if any(each is None for each in found) else tuple(each for each in found if each is not None)
