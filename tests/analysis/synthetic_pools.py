"""Cells and measures of synthetic pools, in the formats of `load` and `run_measures`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from analysis.measures.pooling import pool_runs
from analysis.measures.tested import MEASURES

PARKOUR = {"classic_bipedal": "walking", "fish": "swimming", "climbing_chimpanzee": "climbing"}
PARKOUR_POOL = "classic_bipedal/sac + climbing_chimpanzee/sac + fish/sac"


def cell(teacher: str, seed: int, value: float, **changes: Any) -> dict[str, Any]:
    """Return a row of cells, with the mastered % of its run."""
    row: dict[str, Any] = {"experiment": "original", "environment": "stump_tracks", "challenge": "original"}
    row |= {"embodiment": "classic_bipedal", "student": "sac", "expert_knowledge": "low", "teacher": teacher}
    row |= {"campaign": "first", "seed": seed, "status": "done", "error": "", "steps": 1000.0}
    row |= {"test_set": "stump_tracks", "engine": "Chipmunk", "physics_version": 1.0}
    row |= {"mastery_threshold": 230.0, "mastered_percent": value, "step": 1000.0} | changes
    names = ("environment", "challenge", "embodiment", "student", "expert_knowledge", "teacher", "steps")
    row.setdefault("run_id", "-".join(str(row[name]) for name in (*names, "seed")))
    if row["status"] == "waiting":
        empty = ("steps", "test_set", "physics_version", "mastery_threshold", "mastered_percent", "step")
        return row | dict.fromkeys(empty, None) | {"settings": None}
    return row | {"settings": row.get("settings", f"{row['challenge']} {row['steps']}")}


def cells(values: Mapping[str, Sequence[float]], **changes: Any) -> Iterator[dict[str, Any]]:
    """Yield cells of teachers, one per value, with rising seeds."""
    for teacher, numbers in values.items():
        for seed, value in enumerate(numbers):
            yield cell(teacher, seed, value, **changes)


def parkour(teacher: str, values: dict[str, Sequence[float]], **changes: Any) -> Iterator[dict[str, Any]]:
    """Yield cells of Parkour, one per body and value, with different seeds."""
    seeds = iter(range(1000))
    for body, numbers in values.items():
        locomotion = PARKOUR[body]
        place = {"environment": "parkour", "embodiment": body}
        place |= dict.fromkeys(("experiment", "test_set"), f"parkour_{locomotion}")
        for value in numbers:
            yield cell(teacher, next(seeds), value, **(place | changes))


def pool(*cells: dict[str, Any]) -> pd.DataFrame:
    """Return rows of `pool_runs` for cells, with their value in all measures."""
    rows = pd.DataFrame(cells)
    values = rows[["run_id", "mastered_percent", "step"]].drop_duplicates("run_id")
    values = values.assign(**dict.fromkeys(MEASURES, values["mastered_percent"].astype(float)))
    return pool_runs(rows.drop(columns=["mastered_percent", "step"]), values)
