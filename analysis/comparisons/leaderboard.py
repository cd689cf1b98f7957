"""The leaderboard of a release: ranks, results on each challenge with intervals, and cost."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.comparisons.aggregates import ACROSS, PLACES, stratified_means
from analysis.comparisons.ranks import Rank, ranks
from analysis.data.frames import Frames
from analysis.formatting import amount
from analysis.measures.pooling import PARTS
from analysis.measures.student_pools import runs_after
from analysis.measures.tested import MEASURE
from analysis.names import challenge_title


@dataclass(frozen=True)
class Entry:
    """A teacher of a leaderboard.

    Attributes:
        rank: over all of its challenges, with the ranks that the tests leave open.
        results: mastered test tasks in per cent by the title of the challenge: mean, and both ends of its
            95 % interval; these NaN where runs have no spread.
        hours: median wall-clock time of a run, all its attempts together; NaN if unknown.
    """

    rank: Rank
    results: dict[str, tuple[float, float, float]]
    hours: float


@dataclass(frozen=True)
class Leaderboard:
    """Teachers with results on the same challenges, at one level of expert knowledge and one budget.

    Attributes:
        title: level, budget and engine, and how many challenges where that is not all.
        challenges: titles, in the order of the columns.
        entries: the best first.
    """

    title: str
    challenges: tuple[str, ...]
    entries: tuple[Entry, ...]

    @property
    def timed(self) -> bool:
        """True if the hours of any run are known; those of simulated students are not."""
        return any(not math.isnan(entry.hours) for entry in self.entries)


def leaderboards(frames: Frames) -> list[Leaderboard]:
    """Returns leaderboards for each level of expert knowledge and budget, those with most runs first.

    Teachers are ranked on the same challenges only: beside the leaderboard of those that have results on all,
    there is one for each smaller set of challenges that is all that some teacher has, of everyone who has
    these. A challenge counts where a teacher has all bodies and students that others have on it.

    Args:
        frames: of a release or any root; runs that have not ended count as far as they were evaluated.
    """
    runs = runs_after(frames)
    if runs.empty or not runs[MEASURE].notna().any():
        return []
    hours, found = frames.run_hours, []
    for key, group in runs[runs[MEASURE].notna()].groupby(ACROSS, dropna=False, sort=True):
        across = dict(zip(ACROSS, key, strict=True))
        found.append([_board(across, part, hours, total) for part, total in on_the_same(group)])
    found.sort(key=lambda boards: -sum(entry.rank.n for board in boards for entry in board.entries))
    return [board for boards in found for board in boards]


def on_the_same(runs: pd.DataFrame) -> Iterator[tuple[pd.DataFrame, int]]:
    """Yields the runs of each set of challenges, the largest first, and how many challenges there are.

    A set is all challenges that some teacher has with all of their bodies and students; its runs are those of
    all teachers that have these.
    """
    places = runs.groupby(PLACES, dropna=False, sort=True).ngroup()
    parts = runs.groupby([*PLACES, *PARTS], dropna=False, sort=True).ngroup()
    expected = parts.groupby(places).nunique()
    held: dict[str, frozenset[int]] = {}
    for teacher, mine in parts.groupby(runs["teacher"]):
        counts = mine.groupby(places).nunique()
        held[str(teacher)] = frozenset(counts.index[counts == expected[counts.index]])
    for wanted in sorted(set(held.values()) - {frozenset()}, key=lambda each: (-len(each), sorted(each))):
        everyone = [teacher for teacher, own in held.items() if own >= wanted]
        yield runs[places.isin(wanted) & runs["teacher"].isin(everyone)], len(expected)


def _board(across: dict[str, Any], runs: pd.DataFrame, hours: pd.Series, total: int) -> Leaderboard:
    """Returns the leaderboard of runs on some of `total` challenges."""
    results: dict[str, dict[str, tuple[float, float, float]]] = {}
    titles: dict[str, None] = {}
    for row in stratified_means(runs, MEASURE, [*ACROSS, *PLACES]).to_dict("records"):
        place, challenge = str(row["environment"]), str(row["challenge"])
        title = challenge_title(place, challenge, f"{place} {challenge}")
        titles.setdefault(title)
        result = float(row["difference"]), float(row["low"]), float(row["high"])
        results.setdefault(str(row["teacher"]), {})[title] = result
    spent = runs.assign(hours=runs["run_id"].map(hours)).drop_duplicates(["teacher", "run_id"])
    usual = spent.groupby("teacher")["hours"].median()  # a few stalled runs would decide a mean
    placed = sorted(ranks(runs), key=lambda rank: (rank.rank, rank.teacher))
    entries = tuple(Entry(rank, results[rank.teacher], float(usual[rank.teacher])) for rank in placed)
    version = across["physics_version"]
    engine = f"{across['engine']} {version:g}" if version else across["engine"]
    title = f"expert knowledge {across['expert_knowledge']}, {amount(across['steps'])} steps, {engine}"
    if len(titles) < total:
        title += f": the {len(entries)} teachers on {len(titles)} of {total} challenges"
    return Leaderboard(title, tuple(titles), entries)
