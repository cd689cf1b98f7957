"""The report of a results root: one interactive page that needs nothing but itself, its tables and videos."""

import gzip
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from analysis.baselines.catalogue import Sources, as_baseline, read, source_list
from analysis.claims.judging import decided, root_verdicts
from analysis.comparisons.measured import TESTED, Measured, measure, titled
from analysis.data.columns import COMPARISON, GROUP
from analysis.data.frames import STATUSES, Frames
from analysis.data.identity import parsed
from analysis.formatting import amount, duration, listed, number
from analysis.looks import shown_together
from analysis.measures.evaluations import aggregate, ceilings_in_words, mastered_tasks
from analysis.measures.pooling import runs_after
from analysis.measures.run_measures import run_measures
from analysis.measures.tested import HEADLINE, QUANTITIES, how_tested
from analysis.names import label, teacher_order
from analysis.pages.answer import answers
from analysis.pages.page import controls, leading, overall_section, page, page_folder, write_page
from analysis.pages.sections import Section, best_of, distinct, overview, sections, threshold, thresholds
from tma_ray.tasks import MASTERY_RETURN


def what_ran(cells: pd.DataFrame) -> str:
    """Return the extent of a campaign: ``Random and ALP-GMM, 4 seeds each, 20 million steps``."""
    teachers = [label(teacher) for teacher in sorted(cells["teacher"].unique(), key=teacher_order)]
    named = " and ".join(teachers) if len(teachers) < 3 else f"{len(teachers)} teachers"
    parts = [named]
    seeds, steps = cells.groupby(GROUP)["run_id"].nunique().unique(), cells["steps"].dropna().unique()
    if len(seeds) == 1:
        parts.append(f"{seeds[0]} seed{'s' if seeds[0] > 1 else ''} each")
    if len(steps) == 1:
        parts.append(f"{amount(steps[0])} steps")
    return ", ".join(part for part in parts if part)


def subject(sources: Sources, campaigns: Sequence[str]) -> str:
    """Return the title of a report: names of releases, the only campaign of a root, or names of folders."""
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
    """Return the failed and the running runs with their progress and errors."""
    reached = frames.evaluations.groupby("run_id", observed=True)["step"].max().rename("reached")
    runs = frames.cells.drop_duplicates("run_id").merge(
        reached.rename_axis("run_id").reset_index().astype({"run_id": object}), how="left", on="run_id"
    )
    found: dict[str, list[dict[str, Any]]] = {"failed": [], "running": []}
    for _, run in runs[runs["status"].isin(list(found))].sort_values([*GROUP, "seed"]).iterrows():
        places = run["environment"], run["challenge"], run["student"], run["expert_knowledge"]
        step, error = run["reached"], run["error"].strip()
        found[run["status"]].append(
            {
                "run_id": run["run_id"],
                "teacher": label(run["teacher"]),
                "setting": ", ".join(places),
                "seed": run["seed"],
                "reached": "not evaluated yet" if pd.isna(step) else f"evaluated at {amount(step)}",
                "steps": amount(run["steps"]),
                "reason": error.splitlines()[-1] if error else "no message",
                "error": error,
            }
        )
    return found


def machines(attempts: pd.DataFrame) -> list[dict[str, Any]]:
    """Return machines and versions of the runs, one entry per distinct fingerprint."""
    fingerprints = attempts.astype({"fingerprint": object, "host": object}).groupby("fingerprint")
    return [
        {
            "hosts": sorted(rows["host"].unique()),
            "attempts": len(rows),
            "time": duration(rows["wall_seconds"].sum()),
            "speed": number(rows["env_steps_per_second"].median(), 0),
            "content": parsed(fingerprint) or {"fingerprint": fingerprint},
        }
        for fingerprint, rows in fingerprints
    ]


def settings(cells: pd.DataFrame) -> list[dict[str, str]]:
    """Return the settings that runs were made with, one entry for each that differs."""
    columns = ["engine", "environment", "physics_version", "test_set", "mastery_threshold", "steps"]
    found = []
    for _, rows in cells.dropna(subset=["steps"]).groupby(columns, dropna=False, sort=True):
        engine, environment, physics, test_set, mastery, steps = rows.iloc[0][columns]
        bodies = sorted({str(body) for body in rows["embodiment"] if body})
        found.append(
            {
                "Environment": str(environment).replace("_", " "),
                "Bodies": ", ".join(body.replace("_", " ") for body in bodies) or "\N{EN DASH}",
                "Physics": f"{engine}, version {physics:g}" if physics > 0 else str(engine),
                "Test set": str(test_set),
                "Mastered over": threshold(mastery),
                "Steps": amount(steps),
                "Runs": str(rows["run_id"].nunique()),
            }
        )
    return found


class Download(NamedTuple):
    """A CSV file of the report: name, meaning of a row, content, and the content compressed by gzip."""

    name: str
    row: str
    content: bytes
    compressed: bytes


def downloads(frames: Frames, measured: Measured) -> Iterator[Download]:
    """Yield the tables of a report, in order."""
    curves = [
        aggregate(table, value).assign(measure=value)
        for table, value in (
            (measured.evaluations, "mastered_percent"),
            (measured.evaluations, "evaluation_return"),
            (measured.training, "training_return"),
        )
    ]
    words = frames.test_tasks["task"].map(lambda task: " ".join(f"{x:g}" for x in task))
    tables = {
        "summary": ("one teacher in one comparison", measured.summary),
        "seeds": ("one run at its final evaluation", measured.finals),
        "tests": ("one test against Random, with Holm's adjustment of p", measured.tests),
        "learning_curves": ("one measure of one teacher at one step", pd.concat(curves, ignore_index=True)),
        "mastered_tasks": (
            "one test task and the share of seeds that master it",
            mastered_tasks(frames, measured.finals).merge(frames.test_tasks.assign(task=words)),
        ),
        "measures": ("one run: area under its curve, steps to a share, forgetting", run_measures(frames)),
        "runs": ("one run of one cell and its state", frames.cells.drop(columns="spec")),
    }
    for name, (row, table) in tables.items():
        content = table.to_csv(index=False, lineterminator="\n").encode()
        yield Download(f"{name}.csv", row, content, gzip.compress(content, mtime=0))


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


def write_report(
    sources: Sources, output: Path | None = None, videos: Sequence[Video] = (), reload: int = 0
) -> Path:
    """Write the report of a root, finished or not, with its tables.

    Args:
        sources: results roots and baselines with runs: folders, addresses, names.
        output: folder to write to; ``report`` in the first of `sources` if that is a folder.
        videos: videos to embed, of `wanted_videos`.
        reload: time after which an open page reads itself again, s; 0 for never.

    Returns:
        The page, ``index.html`` in `output`; next to it figures (PNG) and tables (CSV).

    Raises:
        ResultsRootError: one of `sources` is not a results root.
        ValueError: an object store and no `output`.
    """
    output = report_folder(sources, output)
    frames = read(sources)
    measured = measure(frames)
    shown = leading(measured.finals, HEADLINE, frames.cells["teacher"], COMPARISON)
    with shown_together(frames.cells["teacher"]):
        parts = list(sections(frames, measured, shown))
        tables = list(downloads(frames, measured))
        campaigns = sorted(name for name in frames.cells["campaign"].unique() if name)
        text = _render(
            frames,
            measured,
            parts,
            shown,
            downloads=tables,
            videos=by_comparison(videos),
            reload=reload,
            subject=subject(sources, campaigns),
            campaigns=campaigns,
        )
    pictures = {f"{picture.name}.png": picture.png for part in parts for picture in part.pictures}
    return write_page(output, text, pictures | {table.name: table.content for table in tables})


def report_folder(sources: Sources, output: Path | None) -> Path:
    """Return the folder that a report of `sources` is written to.

    Raises:
        ValueError: an object store and no `output`.
    """
    return page_folder(source_list(sources)[0], output, "report", "report")


def _render(
    frames: Frames, measured: Measured, parts: list[Section], shown: Collection[str], **content: Any
) -> str:
    cells = frames.cells
    verdicts, notes = root_verdicts(frames)
    states = cells.drop_duplicates("run_id")["status"].value_counts()
    quantity, titles = QUANTITIES[HEADLINE], distinct([part.title for part in parts])
    caption = "Marks are means over seeds, lines their 95 % intervals. Choose above what is shown and when."
    return page(
        "report.html.j2",
        ran=what_ran(cells),
        counts={"runs": int(states.sum())} | {status: int(states.get(status, 0)) for status in STATUSES},
        warnings=[*frames.notes, *notes],
        controls=controls(
            cells[COMPARISON].drop_duplicates().sort_values(COMPARISON),
            cells["teacher"],
            measured.evaluations["step"].unique(),
            shown,
        ),
        answers=list(answers(frames)),
        overview=overview(parts, titles, quantity, "All comparisons", caption),
        comparisons=list(zip(parts, titles, map(best_of, parts), strict=True)),
        sections=parts,
        overall=overall_section(runs_after(frames)),
        tests=int((measured.tests["p"].notna() & (measured.tests["measure"] == TESTED[0])).sum()),
        verdicts=decided(verdicts),
        unfinished=unfinished(frames),
        settings=settings(cells),
        machines=machines(frames.attempts),
        mastery=thresholds(cells) or number(MASTERY_RETURN, 0),
        ceilings=ceilings_in_words(frames),
        quantity=quantity,
        how_tested=how_tested("all teachers of a comparison against Random"),
        **content,
    )
