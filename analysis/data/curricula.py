"""Curricula of runs: training tasks, probed tasks, and logged updates of the teacher."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames, check_columns
from analysis.data.specs import parsed
from tma_ray.results import Table
from tma_ray.support.validation import check_type
from tma_ray.tasks import MASTERY_RETURN

PANELS = 5  # number of equal parts into which charts divide a run, one panel each

RETURN_RANGE = (-100.0, 300.0)
"""Ends of the colour scale of returns in worlds of the benchmark: an immediate fall, and the end of the
track. In worlds with another mastery threshold, they are the 2nd and 98th percentile."""


@dataclass(frozen=True, eq=False)
class RunCurriculum:
    """Curriculum of one run: training tasks, probed tasks, and updates of the teacher."""

    episodes: pd.DataFrame  # step, task, world_task and episodic_return
    probes: pd.DataFrame  # step and task
    updates: pd.DataFrame  # step, and the teacher's gaussians, boxes and scalars
    steps: int  # length of the run in environment steps
    mastery: float = MASTERY_RETURN  # mastery threshold, an episodic return
    seed: int = 0  # seed of the run

    @property
    def shuffled(self) -> bool:
        """True if the teacher's task space is shuffled."""
        return bool(self.episodes["world_task"].notna().any())

    @property
    def tasks(self) -> NDArray[np.float32]:
        """Tasks (n, d) of the episodes, with any shuffling of the task space undone."""
        column = self.episodes["world_task" if self.shuffled else "task"]
        return stack(column)

    def during(self, part: int) -> "RunCurriculum":
        """Return the curriculum during one of the `PANELS` equal parts of the run."""
        low, high = self.steps * part / PANELS, self.steps * (part + 1) / PANELS

        def cut(frame: pd.DataFrame) -> pd.DataFrame:
            return frame[(frame["step"] > low) & (frame["step"] <= high)]

        return replace(self, episodes=cut(self.episodes), probes=cut(self.probes), updates=cut(self.updates))

    def probed_at(self, step: int) -> NDArray[np.float32]:
        """Return the tasks (n, d) of the last probe up to `step`; empty if all probes are before `step`."""
        steps = self.probes["step"]
        last = steps[steps <= step].max() if (steps >= step).any() else None
        return stack(self.probes.loc[steps == last, "task"])

    def update_at(self, step: int) -> pd.Series | None:
        """Return the teacher's last update up to `step`, or None if there was none."""
        earlier = self.updates[self.updates["step"] <= step].sort_values("step", kind="stable")
        return None if earlier.empty else earlier.iloc[-1]


def stack(tasks: pd.Series) -> NDArray[np.float32]:
    """Stack a column of tasks into an array (n, d), of shape (0, 0) if there are none."""
    return np.stack(tasks.to_list()).astype(np.float32) if len(tasks) else np.empty((0, 0), np.float32)


def return_range(curricula: Mapping[str, RunCurriculum], mastery: float) -> tuple[float, float]:
    """Return the ends of the colour scale of returns, `RETURN_RANGE` for worlds of the benchmark."""
    if mastery == MASTERY_RETURN:
        return RETURN_RANGE
    returns = np.concatenate(
        [curriculum.episodes["episodic_return"].to_numpy(float) for curriculum in curricula.values()]
    )
    low, high = np.percentile([*returns, mastery], (2, 98))
    return min(low, mastery), max(high, mastery)


MOST_MOMENTS = 6  # default for the maximum number of steps at which a run is drawn


def moments(curricula: Mapping[str, RunCurriculum], count: int = MOST_MOMENTS) -> list[int]:
    """Return at most `count` steps at which any teacher was probed, evenly spaced."""
    probes = [curriculum.probes["step"].unique() for curriculum in curricula.values()]
    steps = sorted({int(step) for unique in probes for step in unique})
    chosen = np.unique(np.linspace(0, len(steps) - 1, min(count, len(steps))).round().astype(int))
    return [steps[index] for index in chosen] if steps else []


def gaussians_of(update: pd.Series) -> list[dict[str, Any]]:
    """Return the mixture components of an update, the heaviest first."""
    gaussians = update["gaussians"] if update["gaussians"] is not None else ()
    return sorted(gaussians, key=lambda gaussian: -float(gaussian["weight"]))


def boxes_of(update: pd.Series) -> list[dict[str, Any]]:
    """Return the boxes of an update in drawing order: by ascending score if projected, then largest first."""
    boxes = update["boxes"] if update["boxes"] is not None else ()

    def height(box: dict[str, Any]) -> tuple[float, float]:
        return box.get("above", 0.0), -float(np.prod(np.subtract(box["high"], box["low"])))

    return sorted(boxes, key=height)


def curriculum_of(frames: Frames, run: pd.Series) -> RunCurriculum:
    """Return the curriculum of one run (a row of `Frames.cells`)."""
    check_type("run", run, pd.Series, "a row of frames.cells")
    (curriculum,) = curricula_of_runs(frames, [run])
    return curriculum


def curricula_of_runs(frames: Frames, runs: Sequence[pd.Series]) -> list[RunCurriculum]:
    """Read the curricula of several runs (rows of `Frames.cells`) in one pass."""
    run_ids = [run["run_id"] for run in runs]
    episodes, probes, updates = (
        frames.of_runs(table, run_ids) for table in (Table.EPISODES, Table.CURRICULUM, Table.TEACHER_LOG)
    )
    return [
        RunCurriculum(
            episodes=episodes[run["run_id"]],
            probes=probes[run["run_id"]],
            updates=updates[run["run_id"]],
            steps=int(run["steps"]),
            mastery=float(run["mastery_threshold"]),
            seed=int(run["seed"]),
        )
        for run in runs
    ]


class Axis(NamedTuple):
    """Dimension of the task space: its label with the unit, and its bounds."""

    name: str
    low: float
    high: float


def task_axes(cells: pd.DataFrame) -> tuple[Axis, ...]:
    """Return the dimensions of the teachers' task space in the runs of `cells`; empty if unknown."""
    check_columns("cells", cells, ["spec"])
    axes = []
    for axis in parsed(next(iter(cells["spec"].dropna()), None)).get("task_space", []):
        unit = f" ({axis['unit']})" if axis.get("unit") else ""
        name = str(axis["name"]).replace("_", " ").capitalize() + unit
        axes.append(Axis(name, float(axis["low"]), float(axis["high"])))
    return tuple(axes)
