"""Videos of a report: the policies that it shows at work, and their files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.comparisons.measured import Measured
from analysis.data.frames import Frames
from analysis.formatting import number
from analysis.measures.tested import HEADLINE
from analysis.names import label, teacher_order
from analysis.pages.sections import titled

KINDS = {".mp4": "video/mp4", ".gif": "image/gif"}
"""Files that a page can embed."""


@dataclass(frozen=True)
class WantedVideo:
    """An episode to be shown in a report.

    Attributes:
        comparison: anchor of the section it belongs to.
        teacher: teacher of the run.
        run_id: run whose policy plays.
        rank: "best" or "worst" of the teacher's seeds, "only" where there is one.
        seed: seed of the run.
        test_set: test set of the task.
        task_index: its place in the test set.
        task: values by dimension, separated by commas.
    """

    comparison: str
    teacher: str
    run_id: str
    rank: str
    seed: int
    test_set: str
    task_index: int
    task: str

    @property
    def name(self) -> str:
        """Name of a file."""
        return f"{self.run_id}-{self.test_set}-{self.task_index}"


@dataclass(frozen=True)
class Video:
    """A video file of a wanted episode, and its return."""

    wanted: WantedVideo
    file: Path
    episodic_return: float

    @property
    def content(self) -> bytes:
        """Content of the file."""
        return self.file.read_bytes()

    @property
    def kind(self) -> str:
        """Media type of the file."""
        return KINDS[self.file.suffix]

    @property
    def caption(self) -> str:
        """Teacher, seed, task and return in words."""
        which = "its only seed" if self.wanted.rank == "only" else f"its {self.wanted.rank} seed"
        return (
            f"{label(self.wanted.teacher)}, seed {self.wanted.seed} ({which} by mastered tasks), on test "
            f"task {self.wanted.task_index} ({self.wanted.task}): return {number(self.episodic_return)}"
        )


def wanted_videos(frames: Frames, measured: Measured) -> Iterator[WantedVideo]:
    """Yield the best and the worst finished seed of every teacher, by mastered tasks.

    All policies of a comparison play the same test task: the one on which the returns of its runs differ
    most, since there a viewer sees what tells them apart.
    """
    for anchor, _, mine in titled(measured):
        finished = mine.finals[mine.finals["status"] == "done"]
        evaluations = frames.evaluations_of(finished["run_id"].unique())
        evaluations = evaluations.astype({"run_id": object, "test_set": object})
        rows = evaluations.merge(finished[["run_id", "step"]], on=["run_id", "step"])
        differences = rows.groupby(["test_set", "task_index"])["episodic_return"].std(ddof=0)
        if differences.empty:
            continue
        key: Any = differences.idxmax()
        chosen, tasks = (str(key[0]), int(key[1])), frames.test_tasks
        task = tasks[(tasks["test_set"] == chosen[0]) & (tasks["task_index"] == chosen[1])]["task"].iloc[0]
        words = ",".join(f"{value:.9g}" for value in task)
        for teacher in sorted(finished["teacher"].unique(), key=teacher_order):
            runs = finished[finished["teacher"] == teacher]
            ranked = runs.sort_values([HEADLINE, "evaluation_return", "seed"], kind="stable")
            for rank, place in (("best", -1), ("worst", 0)) if len(ranked) > 1 else (("only", 0),):
                run = ranked.iloc[place]
                names = (anchor, teacher, run["run_id"], rank, int(run["seed"]))
                yield WantedVideo(*names, *chosen, words)


def by_comparison(videos: Sequence[Video]) -> dict[str, list[Video]]:
    """Return the videos of each section by its anchor."""
    found: dict[str, list[Video]] = {}
    for video in videos:
        found.setdefault(video.wanted.comparison, []).append(video)
    return found
