"""Report on a results root: a self-contained interactive page with tables and videos."""

import gzip
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from analysis.baselines.catalogue import Sources, as_baseline, read, source_list
from analysis.charts.catalogue import threshold, thresholds
from analysis.claims.judging import decided, root_verdicts
from analysis.comparisons.comparison import Measurements
from analysis.data.columns import COMPARISON, GROUP
from analysis.data.frames import STATUSES, Frames, object_strings
from analysis.data.specs import parsed
from analysis.formatting import listed, number, steps_text
from analysis.measures.evaluations import aggregate, ceiling_sentences, mastered_tasks
from analysis.measures.pooling import runs_after
from analysis.measures.run_measures import run_measures
from analysis.measures.tested import HEADLINE, QUANTITIES, how_tested
from analysis.names import label, teacher_order
from analysis.pages.page import controls, overall_section, page, page_folder, write_page
from analysis.pages.sections import Section, answers, best_of, distinct, overview, sections
from analysis.teacher_styles import shown_together
from tma_ray.support.texts import counted, rounded_duration
from tma_ray.tasks import MASTERY_RETURN


def what_ran(cells: pd.DataFrame) -> str:
    """Summarise teachers, seeds and steps: ``Random and ALP-GMM, 4 seeds each, 20 million steps``."""
    teachers = [label(teacher) for teacher in sorted(cells["teacher"].unique(), key=teacher_order)]
    named = " and ".join(teachers) if len(teachers) < 3 else f"{len(teachers)} teachers"
    parts = [named]
    seeds, steps = cells.groupby(GROUP)["run_id"].nunique().unique(), cells["steps"].dropna().unique()
    if len(seeds) == 1:
        parts.append(f"{counted(int(seeds[0]), 'seed')} each")
    if len(steps) == 1:
        parts.append(f"{steps_text(steps[0])} steps")
    return ", ".join(part for part in parts if part)


def subject(sources: Sources, campaigns: Sequence[str]) -> str:
    """Return the title of a report: names of releases, and of a root's only campaign or its folder."""
    names = []
    for place in source_list(sources):
        if baseline := as_baseline(place):
            names.append(baseline.manifest.name)
        elif len(campaigns) == 1:
            names.append(f"{campaigns[0][:1].upper()}{campaigns[0][1:]}".replace("_", " "))
        else:
            names.append(Path(place).resolve().name if campaigns else "Training runs")
    return listed(dict.fromkeys(names))


def unfinished(frames: Frames) -> dict[str, list[dict[str, Any]]]:
    """Return the failed and the running runs, with their progress and errors."""
    reached = frames.evaluations.groupby("run_id", observed=True)["step"].max().rename("reached")
    runs = frames.cells.drop_duplicates("run_id").merge(
        reached.rename_axis("run_id").reset_index().astype({"run_id": object}), how="left", on="run_id"
    )
    rows: dict[str, list[dict[str, Any]]] = {"failed": [], "running": []}
    for _, run in runs[runs["status"].isin(list(rows))].sort_values([*GROUP, "seed"]).iterrows():
        conditions = run["environment"], run["challenge"], run["student"], run["expert_knowledge"]
        step, error = run["reached"], run["error"].strip()
        rows[run["status"]].append(
            {
                "run_id": run["run_id"],
                "teacher": label(run["teacher"]),
                "setting": ", ".join(conditions),
                "seed": run["seed"],
                "reached": "not evaluated yet" if pd.isna(step) else f"evaluated at {steps_text(step)}",
                "steps": steps_text(run["steps"]),
                "reason": error.splitlines()[-1] if error else "no message",
                "error": error,
            }
        )
    return rows


def machines(attempts: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the machines and software of attempts, one entry per fingerprint."""
    fingerprints = attempts.astype({"fingerprint": object, "host": object}).groupby("fingerprint")
    return [
        {
            "hosts": sorted(rows["host"].unique()),
            "attempts": len(rows),
            "time": rounded_duration(rows["wall_seconds"].sum()),
            "speed": number(rows["env_steps_per_second"].median(), 0),
            "content": parsed(fingerprint) or {"fingerprint": fingerprint},
        }
        for fingerprint, rows in fingerprints
    ]


def settings(cells: pd.DataFrame) -> list[dict[str, str]]:
    """Return an entry for each distinct combination of settings of runs (environment, physics, ...)."""
    columns = ["engine", "environment", "physics_version", "test_set", "mastery_threshold", "steps"]
    entries = []
    for _, rows in cells.dropna(subset=["steps"]).groupby(columns, dropna=False, sort=True):
        engine, environment, physics, test_set, mastery, steps = rows.iloc[0][columns]
        bodies = sorted({str(body) for body in rows["embodiment"] if body})
        entries.append(
            {
                "Environment": str(environment).replace("_", " "),
                "Bodies": ", ".join(body.replace("_", " ") for body in bodies) or "\N{EN DASH}",
                "Physics": f"{engine}, version {physics:g}" if physics > 0 else str(engine),
                "Test set": str(test_set),
                "Mastered over": threshold(mastery),
                "Steps": steps_text(steps),
                "Runs": str(rows["run_id"].nunique()),
            }
        )
    return entries


class Download(NamedTuple):
    """CSV file of a report: name, description of a row, content, gzipped content."""

    name: str
    row: str
    content: bytes
    compressed: bytes


def downloads(measurements: Measurements) -> Iterator[Download]:
    """Yield the tables of a report as CSV files, in the order of the page."""
    frames = measurements.frames
    curves = [
        aggregate(table, value).assign(measure=value)
        for table, value in (
            (measurements.evaluations, "mastered_percent"),
            (measurements.evaluations, "evaluation_return"),
            (measurements.training, "training_return"),
        )
    ]
    words = frames.test_tasks["task"].map(lambda task: " ".join(f"{x:g}" for x in task))
    tables = {
        "summary": ("one teacher in one comparison", measurements.summary),
        "seeds": ("one run at its final evaluation", measurements.finals),
        "tests": ("one test against Random, with Holm's adjustment of p", measurements.tests),
        "learning_curves": ("one measure of one teacher at one step", pd.concat(curves, ignore_index=True)),
        "mastered_tasks": (
            "one test task and the share of seeds that master it",
            mastered_tasks(frames, measurements.finals).merge(frames.test_tasks.assign(task=words)),
        ),
        "measures": ("one run: area under its curve, steps to a share, forgetting", run_measures(frames)),
        "runs": ("one run of one cell and its state", frames.cells.drop(columns="spec")),
    }
    for name, (row, table) in tables.items():
        content = table.to_csv(index=False, lineterminator="\n").encode()
        yield Download(f"{name}.csv", row, content, gzip.compress(content, mtime=0))


MEDIA_TYPES = {".mp4": "video/mp4", ".gif": "image/gif"}
"""Media types of videos that a page can embed, by suffix."""


@dataclass(frozen=True)
class VideoRequest:
    """Episode to be shown as a video in a report.

    Attributes:
        comparison: anchor of its section.
        teacher: teacher of the run.
        run_id: run with the policy.
        rank: "best" or "worst" of the teacher's seeds, or "only".
        seed: seed of the run.
        test_set: test set of the task.
        task_index: index of the task in the test set.
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
        """File name of the video without suffix."""
        return f"{self.run_id}-{self.test_set}-{self.task_index}"


@dataclass(frozen=True)
class Video:
    """Recorded video of an episode, with its return."""

    request: VideoRequest
    file: Path
    episodic_return: float

    @property
    def content(self) -> bytes:
        """Content of the video file."""
        return self.file.read_bytes()

    @property
    def kind(self) -> str:
        """Media type of the video file."""
        return MEDIA_TYPES[self.file.suffix]

    @property
    def caption(self) -> str:
        """Caption with teacher, seed, task and return."""
        which = "its only seed" if self.request.rank == "only" else f"its {self.request.rank} seed"
        return (
            f"{label(self.request.teacher)}, seed {self.request.seed} ({which} by mastered tasks), on test "
            f"task {self.request.task_index} ({self.request.task}): return {number(self.episodic_return)}"
        )


def video_requests(measurements: Measurements) -> Iterator[VideoRequest]:
    """Yield the episodes that a report shows as videos: each teacher's best and worst finished runs.

    All policies of a comparison play the test task on which the returns of its runs differ most.
    """
    frames = measurements.frames
    for comparison in measurements.comparisons:
        finished = comparison.finals[comparison.finals["status"] == "done"]
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
            for rank, index in (("best", -1), ("worst", 0)) if len(ranked) > 1 else (("only", 0),):
                run = ranked.iloc[index]
                names = (comparison.anchor, teacher, run["run_id"], rank, int(run["seed"]))
                yield VideoRequest(*names, *chosen, words)


def by_comparison(videos: Sequence[Video]) -> dict[str, list[Video]]:
    """Group videos by the anchor of their section."""
    sections: dict[str, list[Video]] = {}
    for video in videos:
        sections.setdefault(video.request.comparison, []).append(video)
    return sections


@object_strings()
def write_report(
    sources: Sources, output: Path | None = None, videos: Sequence[Video] = (), reload: int = 0
) -> Path:
    """Write the report on a root, finished or not, with its tables.

    Args:
        sources: results roots and baselines with runs: folders, addresses, names.
        output: folder to write to; ``report`` in the first of `sources` if that is a folder.
        videos: videos to embed, from `video_requests`.
        reload: interval at which an open page reloads, in seconds; 0 for never.

    Returns:
        The page, ``index.html`` in `output`; next to it figures (PNG) and tables (CSV).

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
        ValueError: if the first source is an object store, without `output`.
    """
    folder, measurements = report_folder(sources, output), Measurements(read(sources))
    with shown_together(measurements.cells["teacher"]):
        parts, tables = list(sections(measurements)), list(downloads(measurements))
        campaigns = sorted(name for name in measurements.cells["campaign"].unique() if name)
        text = page(
            "report.html.j2",
            subject=subject(sources, campaigns),
            campaigns=campaigns,
            reload=reload,
            videos=by_comparison(videos),
            downloads=tables,
            **_sections_content(parts),
            **_root_content(measurements),
        )
    pictures = {f"{picture.name}.png": picture.png for part in parts for picture in part.pictures}
    return write_page(folder, text, pictures | {table.name: table.content for table in tables})


def report_folder(sources: Sources, output: Path | None) -> Path:
    """Return the folder of the report on `sources`.

    Raises:
        ValueError: if the first source is an object store, without `output`.
    """
    return page_folder(source_list(sources)[0], output, "report", "report")


def _sections_content(parts: Sequence[Section]) -> dict[str, Any]:
    """Return the page content about each comparison, with an overview of all, as template variables."""
    quantity, titles = QUANTITIES[HEADLINE], distinct([part.title for part in parts])
    caption = "Marks are means over seeds, lines their 95 % intervals. Choose above what is shown and when."
    return {
        "sections": parts,
        "overview": overview(parts, titles, quantity, "All comparisons", caption),
        "comparisons": list(zip(parts, titles, map(best_of, parts), strict=True)),
        "quantity": quantity,
    }


def _root_content(measurements: Measurements) -> dict[str, Any]:
    """Return the page content about the whole root, as template variables."""
    frames, cells, tests = measurements.frames, measurements.cells, measurements.tests
    verdicts, notes = root_verdicts(frames)
    states = cells.drop_duplicates("run_id")["status"].value_counts()
    return {
        "ran": what_ran(cells),
        "counts": {"runs": int(states.sum())} | {status: int(states.get(status, 0)) for status in STATUSES},
        "warnings": [*frames.notes, *notes],
        "controls": controls(
            cells[COMPARISON].drop_duplicates().sort_values(COMPARISON),
            cells["teacher"],
            measurements.evaluations["step"].unique(),
            measurements.shown,
        ),
        "answers": list(answers(frames)),
        "overall": overall_section(runs_after(frames)),
        "tests": int((tests["p"].notna() & (tests["measure"] == HEADLINE)).sum()),
        "verdicts": decided(verdicts),
        "unfinished": unfinished(frames),
        "settings": settings(cells),
        "machines": machines(frames.attempts),
        "mastery": thresholds(cells) or number(MASTERY_RETURN, 0),
        "ceilings": ceiling_sentences(frames),
        "how_tested": how_tested("all teachers of a comparison against Random"),
    }
