"""Facts of a report: runs done and unfinished, settings, machines."""

from __future__ import annotations

from typing import Any

import pandas as pd

from analysis.data.frames import GROUP, STATUSES, Frames
from analysis.data.specs import parsed
from analysis.formatting import amount, duration, number
from analysis.names import label, teacher_order
from analysis.pages.report.captions import threshold


def counts_of(cells: pd.DataFrame) -> dict[str, int]:
    """Returns how many runs there are, in all and in each state."""
    runs = cells.drop_duplicates("run_id")["status"].value_counts()
    return {"runs": int(runs.sum())} | {status: int(runs.get(status, 0)) for status in STATUSES}


def what_ran(cells: pd.DataFrame) -> str:
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


def unfinished(frames: Frames) -> dict[str, list[dict[str, Any]]]:
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


def machines(attempts: pd.DataFrame) -> list[dict[str, Any]]:
    """Returns what the runs were computed with, versions included, one entry per distinct fingerprint."""
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


def settings(cells: pd.DataFrame) -> list[dict[str, str]]:
    """Returns the settings that runs were made with, one entry for each that differs."""
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
