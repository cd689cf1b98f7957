"""The leaderboard of a release: ranks, results on each challenge with intervals, and cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.comparisons.aggregates import ACROSS, PLACES, stratified_means
from analysis.comparisons.ranks import Rank, ranks
from analysis.data.frames import Frames
from analysis.formatting import amount
from analysis.measures.student_pools import runs_after
from analysis.measures.tested import MEASURE
from analysis.names import challenge_title


@dataclass(frozen=True)
class Entry:
    """A teacher of a leaderboard.

    Attributes:
        rank: over all of its challenges, with what of it is certain.
        results: mastered test tasks in per cent, mean and 95 % margin, by the title of the challenge.
        hours: of a run, on one core of the machines that the release was made on; NaN if unknown.
    """

    rank: Rank
    results: dict[str, tuple[float, float]]
    hours: float


@dataclass(frozen=True)
class Leaderboard:
    """Teachers that may be compared, at one level of expert knowledge and one budget.

    Attributes:
        title: level, budget and engine.
        challenges: titles, in the order of the columns.
        entries: the best first.
    """

    title: str
    challenges: tuple[str, ...]
    entries: tuple[Entry, ...]


def leaderboards(frames: Frames) -> list[Leaderboard]:
    """Returns a leaderboard for each level of expert knowledge and budget, those with most runs first.

    Args:
        frames: of a release or any root; runs that have not ended count as far as they were evaluated.
    """
    runs = runs_after(frames)
    if runs.empty or not runs[MEASURE].notna().any():
        return []
    hours = _hours(frames)
    found = [
        _board(dict(zip(ACROSS, key, strict=True)), group, hours)
        for key, group in runs[runs[MEASURE].notna()].groupby(ACROSS, dropna=False, sort=True)
    ]
    return sorted(found, key=lambda board: -sum(entry.rank.n for entry in board.entries))


def _board(across: dict[str, Any], runs: pd.DataFrame, hours: pd.Series) -> Leaderboard:
    results: dict[str, dict[str, tuple[float, float]]] = {}
    titles: dict[str, None] = {}
    for row in stratified_means(runs, MEASURE, [*ACROSS, *PLACES]).to_dict("records"):
        place, challenge = str(row["environment"]), str(row["challenge"])
        title = challenge_title(place, challenge, f"{place} {challenge}")
        titles.setdefault(title)
        result = float(row["difference"]), float(row["high"] - row["low"]) / 2
        results.setdefault(str(row["teacher"]), {})[title] = result
    spent = runs.assign(hours=runs["run_id"].map(hours)).drop_duplicates(["teacher", "run_id"])
    mean_hours = spent.groupby("teacher")["hours"].mean()
    entries = (Entry(rank, results[rank.teacher], float(mean_hours[rank.teacher])) for rank in ranks(runs))
    version = across["physics_version"]
    engine = f"{across['engine']} {version:g}" if version else across["engine"]
    title = f"expert knowledge {across['expert_knowledge']}, {amount(across['steps'])} steps, {engine}"
    return Leaderboard(title, tuple(titles), tuple(entries))


def _hours(frames: Frames) -> pd.Series:
    """Returns the hours of all attempts at each run, by run id."""
    attempts = frames.attempts
    if attempts.empty:
        return pd.Series(dtype=float)
    seconds = attempts["wall_seconds"].groupby(attempts["run_id"].astype(str)).sum()
    return seconds / 3600
