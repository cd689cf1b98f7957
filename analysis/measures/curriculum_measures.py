"""Coverage and entropy of curricula in the task space."""

from collections.abc import Iterable, Iterator
from numbers import Integral

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames
from analysis.data.specs import parsed
from tma_ray.support.quantities import STEP
from tma_ray.support.validation import check_sequence, check_type
from tma_ray.tasks import Dimension, Task, TaskSpace

BINS = 10
"""Number of grid cells along each dimension."""

GRID_DIMENSIONS = 3
"""Maximum number of free dimensions of a joint grid; with more, its cells outnumber any probe's tasks."""


def coverage_and_entropy(tasks: Task, space: TaskSpace, bins: int = BINS) -> tuple[float, float]:
    """Return the share of grid cells that contain tasks, and the normalised entropy of tasks over cells.

    Dimensions without width are ignored. With more than `GRID_DIMENSIONS` others, both numbers are means over
    the grids of single dimensions, which ignore dependence between dimensions.

    Args:
        tasks: values (n, d), in task units; those outside the space count in the nearest cell.
        space: bounds of the grid.
        bins: cells along each dimension.

    Returns:
        Coverage, and Shannon's entropy as a share of its maximum: both in [0, 1], and NaN without tasks or
        free dimensions. n tasks occupy at most n cells, so only equal n are comparable.

    Raises:
        ValueError: if `bins` is below 2.
    """
    _check_bins(bins)
    free = space.width > 0
    if not len(tasks) or not free.any():
        return np.nan, np.nan
    cells = np.minimum((np.clip(space.normalise(tasks), 0, 1)[:, free] * bins).astype(int), bins - 1)
    shape = (bins,) * cells.shape[1]
    if len(shape) <= GRID_DIMENSIONS:
        return _occupation(np.ravel_multi_index(tuple(cells.T), shape), bins ** len(shape))
    coverage, entropy = np.mean([_occupation(column, bins) for column in cells.T], axis=0)
    return float(coverage), float(entropy)


def curriculum_measures(
    frames: Frames, run_ids: Iterable[str], at: int | None = None, bins: int = BINS
) -> pd.DataFrame:
    """Return the coverage and entropy of all probed tasks of each run.

    Args:
        frames: results with probed tasks, which the teachers would propose without exploration.
        run_ids: runs to measure, one row each, in this order.
        at: last step whose probes count; None for all.
        bins: cells of the grid along each dimension.

    Returns:
        run_id, tasks (number), coverage, entropy; the last two are NaN for runs without probes.
    """
    _check_bins(bins)
    STEP.check("at", 0 if at is None else at)
    rows = []
    for run_id, space, probes in _probes(frames, run_ids):
        counted = probes if at is None else probes[probes["step"] <= at]
        rows.append((run_id, len(counted), *_measured(counted, space, bins)))
    return pd.DataFrame(rows, columns=["run_id", "tasks", "coverage", "entropy"])


def curriculum_curves(frames: Frames, run_ids: Iterable[str], bins: int = BINS) -> pd.DataFrame:
    """Return the coverage and entropy of each probe, with the columns run_id, step, tasks, coverage, entropy.

    Arguments are those of `curriculum_measures`.
    """
    _check_bins(bins)
    rows = [
        (run_id, step, len(probe), *_measured(probe, space, bins))
        for run_id, space, probes in _probes(frames, run_ids)
        for step, probe in probes.groupby("step")
    ]
    return pd.DataFrame(rows, columns=["run_id", "step", "tasks", "coverage", "entropy"])


def _check_bins(bins: int) -> None:
    if not isinstance(bins, Integral) or bins < 2:
        raise ValueError(f"{bins} bins: expected a whole number of at least 2 along each dimension")


def _probes(frames: Frames, run_ids: Iterable[str]) -> Iterator[tuple[str, TaskSpace | None, pd.DataFrame]]:
    """Yield the id, the task space (None if unknown) and the probed tasks of each run."""
    check_type("frames", frames, Frames, "what analysis.load returns")
    check_sequence("run_ids", run_ids)
    specs = frames.cells.drop_duplicates("run_id").set_index("run_id")["spec"]
    for run_id in run_ids:
        dimensions = parsed(specs.get(run_id)).get("task_space", [])
        space = TaskSpace(tuple(Dimension(**fields) for fields in dimensions)) if dimensions else None
        yield run_id, space, frames.curriculum(run_id)


def _measured(probes: pd.DataFrame, space: TaskSpace | None, bins: int) -> tuple[float, float]:
    if space is None or probes.empty:
        return np.nan, np.nan
    return coverage_and_entropy(np.stack(probes["task"].to_list()), space, bins)


def _occupation(cells: NDArray[np.intp], count: int) -> tuple[float, float]:
    """Return the coverage and normalised entropy of tasks in `cells` (n,) of a grid of `count` cells."""
    from scipy import stats

    _, sizes = np.unique(cells, return_counts=True)
    entropy = float(stats.entropy(sizes)) / np.log(count)
    return sizes.size / count, entropy
