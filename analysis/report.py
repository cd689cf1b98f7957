"""The report of a results root: a page that needs nothing but itself, figures and tables beside it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from analysis import measures
from analysis.claims_view import decided, root_verdicts
from analysis.comparison import Measured, measure
from analysis.formatting import amount, duration, number
from analysis.frames import GROUP, STATUSES, Frames, load, parsed
from analysis.pages import page
from analysis.picture import Picture
from analysis.pictures import thresholds
from analysis.run_measures import run_measures
from analysis.sections import Section, sections
from analysis.statistics import SIGNIFICANCE
from analysis.style import label, teacher_order
from tma_ray.tasks import MASTERY_RETURN


@dataclass(frozen=True)
class Download:
    """A CSV file of the report: its name, what a row of it is, and its content."""

    name: str
    row: str
    content: bytes


def write_report(root: str | Path, output: Path | None = None) -> Path:
    """Writes the report of a root, finished or not, with its figures and tables.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        output: folder to write to; ``report`` in `root` if that is a folder.

    Returns:
        The page, ``index.html`` in `output`; beside it figures (PNG) and tables (CSV).

    Raises:
        ResultsRootError: `root` is no results root.
        ValueError: an object store and no `output`.
    """
    if output is None:
        if "://" in str(root):
            raise ValueError(f"{root} is no local folder: say in which folder to write the report")
        output = Path(root) / "report"
    frames = load(root)
    measured = measure(frames)
    parts = list(sections(frames, measured))
    downloads = _downloads(frames, measured)
    text = _render(frames, measured, parts, downloads)
    output.mkdir(parents=True, exist_ok=True)
    for picture in (picture for part in parts for picture in part.pictures):
        (output / f"{picture.name}.png").write_bytes(picture.png)
    for download in downloads:
        (output / download.name).write_bytes(download.content)
    index = output / "index.html"
    index.write_text(text, encoding="utf-8")
    return index


def _downloads(frames: Frames, measured: Measured) -> list[Download]:
    curves = [
        measures.aggregate(table, value).assign(measure=value)
        for table, value in (
            (measured.evaluations, "mastered_percent"),
            (measured.evaluations, "evaluation_return"),
            (measured.training, "training_return"),
        )
    ]
    tasks = measures.mastered_tasks(frames, measured.readings).merge(
        frames.test_tasks.assign(
            task=frames.test_tasks["task"].map(lambda task: " ".join(f"{x:g}" for x in task))
        )
    )
    tables = {
        "summary": ("one teacher in one comparison", measured.summary),
        "seeds": ("one run at its final evaluation", measured.readings),
        "tests": ("one Welch's t-test against Random, with Holm's adjustment of p", measured.tests),
        "learning_curves": ("one measure of one teacher at one step", pd.concat(curves, ignore_index=True)),
        "mastered_tasks": ("one test task and the share of seeds that master it", tasks),
        "measures": ("one run: area under its curve, steps to a share, forgetting", run_measures(frames)),
        "runs": ("one run of one cell and its state", frames.cells.drop(columns="spec")),
    }
    return [
        Download(f"{name}.csv", row, table.to_csv(index=False, lineterminator="\n").encode())
        for name, (row, table) in tables.items()
    ]


def _render(frames: Frames, measured: Measured, parts: list[Section], downloads: list[Download]) -> str:
    pictures: list[Picture] = [picture for part in parts for picture in part.pictures]
    return page(
        "report.html.j2",
        campaigns=sorted(name for name in frames.cells["campaign"].unique() if name),
        ran=_ran(frames.cells),
        counts=_counts(frames.cells),
        warnings=[*frames.warnings, *frames.results.problems],
        sections=parts,
        figure_numbers={picture.name: count for count, picture in enumerate(pictures, start=1)},
        tests=int(measured.tests["p"].notna().sum()) // 2,
        verdicts=decided(root_verdicts(frames)),
        unfinished=_unfinished(frames),
        machines=_machines(frames.attempts),
        downloads=downloads,
        mastery=thresholds(frames.cells) or number(MASTERY_RETURN, 0),
        significance=SIGNIFICANCE,
        version=version("tma_ray"),
        written=datetime.now(UTC),
    )


def _counts(cells: pd.DataFrame) -> dict[str, int]:
    runs = cells.drop_duplicates("run_id")["status"].value_counts()
    return {"runs": int(runs.sum())} | {status: int(runs.get(status, 0)) for status in STATUSES}


def _ran(cells: pd.DataFrame) -> str:
    """Returns what was run: ``Random and ALP-GMM, 4 seeds each, 20 million steps``."""
    teachers = [label(teacher) for teacher in sorted(cells["teacher"].unique(), key=teacher_order)]
    named = " and ".join(teachers) if len(teachers) < 3 else f"{len(teachers)} teachers"
    parts = [named]
    seeds, steps = cells.groupby(GROUP)["run_id"].nunique().unique(), cells["steps"].dropna().unique()
    if len(seeds) == 1:
        parts.append(f"{seeds[0]} seed{'s' if seeds[0] > 1 else ''} each")
    if len(steps) == 1:
        parts.append(f"{amount(steps[0])} steps")
    return ", ".join(part for part in parts if part)


def _unfinished(frames: Frames) -> dict[str, list[dict[str, Any]]]:
    """Returns the failed and the running runs: which, how far, and why they failed."""
    reached = frames.evaluations.groupby("run_id", observed=True)["step"].max().rename("reached")
    runs = frames.cells.drop_duplicates("run_id").merge(
        reached.rename_axis("run_id").reset_index().astype({"run_id": object}), how="left", on="run_id"
    )
    found: dict[str, list[dict[str, Any]]] = {}
    for status in ("failed", "running"):
        rows = runs[runs["status"] == status].sort_values([*GROUP, "seed"])
        found[status] = [_described(row) for _, row in rows.iterrows()]
    return found


def _described(run: pd.Series) -> dict[str, Any]:
    lines = run["error"].strip().splitlines()
    return {
        "run_id": run["run_id"],
        "teacher": label(run["teacher"]),
        "setting": f"{run['environment']}, {run['challenge']}, {run['student']}, {run['expert_knowledge']}",
        "seed": run["seed"],
        "reached": "not evaluated yet"
        if pd.isna(run["reached"])
        else f"evaluated at {amount(run['reached'])}",
        "steps": amount(run["steps"]),
        "reason": lines[-1] if lines else "no message",
        "error": run["error"].strip(),
    }


def _machines(attempts: pd.DataFrame) -> list[dict[str, Any]]:
    """Returns what the runs were computed with, one entry per distinct fingerprint."""
    found = []
    for fingerprint, rows in attempts.astype({"fingerprint": object, "host": object}).groupby("fingerprint"):
        content = parsed(fingerprint) or {"fingerprint": fingerprint}
        found.append(
            {
                "hosts": sorted(rows["host"].unique()),
                "attempts": len(rows),
                "time": duration(rows["wall_seconds"].sum()),
                "speed": number(rows["env_steps_per_second"].median(), 0),
                "content": content,
            }
        )
    return found
