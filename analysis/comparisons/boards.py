"""Teachers over all challenges at once: ranks, leaderboards, and differences to Random."""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.aggregates import (
    ACROSS,
    CHALLENGES,
    PLACES,
    improvements,
    profiles,
    stratified_differences,
    stratified_means,
)
from analysis.comparisons.sentences import in_brief
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import amount, ends, estimate, listed, number, p_value
from analysis.looks import look
from analysis.measures.pooling import CONDITIONS, PARTS, condition_words, runs_after, varying
from analysis.measures.tested import MEASURE
from analysis.names import challenge_title, label, mark_of, marked_label
from analysis.statistics import SIGNIFICANCE, holm

EQUAL = 1e-9
"""Difference of means, in points, below which two teachers share a rank."""


@dataclass(frozen=True)
class Rank:
    """A teacher's rank among those that have results on all of its challenges.

    Attributes:
        teacher: who.
        across: values of `ACROSS`, what all that are ranked have in common.
        challenges: on how many challenges.
        mean: mastered test tasks in per cent, the mean over challenges of equal weight.
        low: lower end of its 95 % interval; NaN with one run on a challenge.
        high: upper end of it.
        n: runs.
        fewest: of them on one challenge, or of another ranked teacher.
        rank: 1 for the highest mean.
        of: how many teachers are ranked.
        better: those that it is better than, with p < 0.05 after Holm's correction.
        worse: those that it is worse than, likewise.
        undecided: the others.
        left_out: those without results on all of its challenges.
    """

    teacher: str
    across: dict[str, Any]
    challenges: int
    mean: float
    low: float
    high: float
    n: int
    fewest: int
    rank: int
    of: int
    better: tuple[str, ...]
    worse: tuple[str, ...]
    undecided: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def best(self) -> int:
        """The best rank that the tests leave open."""
        return 1 + len(self.worse)

    @property
    def worst(self) -> int:
        """The worst rank that the tests leave open."""
        return self.of - len(self.better)

    def describe(self) -> str:
        """Returns rank and verdicts in one sentence."""
        where = f"expert knowledge {self.across['expert_knowledge']}, {amount(self.across['steps'])} steps"
        where += f", {self.across['variant']}" if self.across["variant"] else ""
        over = f"Over {self.challenges} challenge{'s' if self.challenges > 1 else ''} ({where})"
        if self.of == 1:
            return (
                f"{over} {label(self.teacher)} has no rank: no other teacher has results on the same "
                f"challenges under the same conditions."
            )
        best, worst = self.best, self.worst
        certain = f"and the tests leave {best} to {worst} open" if best < worst else "as the tests confirm"
        parts = [("better than", self.better), ("worse than", self.worse)]
        said = [f"{words} {_listed(names)}" for words, names in parts if names]
        said += [f"undecided against {_listed(self.undecided)}"] if self.undecided else []
        lacking = f"; not ranked, lacking challenges: {_listed(self.left_out)}" if self.left_out else ""
        family = f"after Holm for all pairs{in_brief(self.fewest)}"
        return (
            f"{over} {label(self.teacher)} ranks {self.rank} of {self.of} by mean, {certain}: "
            f"{'; '.join(said)} (p < {SIGNIFICANCE} {family}){lacking}."
        )


def ranks(runs: pd.DataFrame, teachers: Collection[str] | None = None, measure: str = MEASURE) -> list[Rank]:
    """Returns the rank of each teacher at each level and budget, the best first.

    One family at each, corrected by Holm: the tests of the pairs of which one is looked at, and of which the
    other has results on all of its challenges. What is not ranked costs no power.

    Args:
        runs: rows of `pooling.pool_runs`.
        teachers: whose ranks; all by default.
        measure: column of `runs`.
    """
    found: list[Rank] = []
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        across = dict(zip(ACROSS, key, strict=True))
        present = sorted(group["teacher"].unique())
        looked = [name for name in present if teachers is None or name in teachers]
        means = {row["teacher"]: row for row in stratified_means(group, measure).to_dict("records")}
        tests = _tests(group, measure, {name: means[name]["challenges"] for name in looked})
        here = [_rank(name, across, means[name], tests[tests["teacher"] == name]) for name in looked]
        found += sorted(here, key=lambda rank: (-rank.mean, rank.teacher))
    return found


def _tests(group: pd.DataFrame, measure: str, challenges: Mapping[str, int]) -> pd.DataFrame:
    """Returns the test of each teacher that is looked at against every other one: its columns, and holm.

    Args:
        group: runs.
        measure: column of `group`.
        challenges: how many each of these teachers has; holm is NaN where neither is ranked beside the other.
    """
    parts, columns = [], ["teacher", "other", "challenges", "fewest", "difference", "p"]
    for teacher in challenges:
        table = stratified_differences(group, measure, teacher)
        flipped = table.assign(other=table["teacher"], teacher=teacher, difference=-table["difference"])
        parts.append(flipped[columns])
    tests = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)
    pairs = [" | ".join(sorted(names)) for names in zip(tests["teacher"], tests["other"], strict=True)]
    ranked = tests["challenges"] == tests["teacher"].map(challenges)
    counted = zip(pairs, tests["p"].astype(float), ranked, strict=True)
    once = {pair: p for pair, p, counts in counted if counts}
    corrected = dict(zip(once, holm(pd.Series(once, dtype=float)), strict=True))
    return tests.assign(holm=[corrected.get(pair, np.nan) for pair in pairs])


def _rank(teacher: str, across: dict[str, Any], mine: dict[Hashable, Any], tests: pd.DataFrame) -> Rank:
    alike = tests[tests["challenges"] == mine["challenges"]]
    sure = alike["holm"] < SIGNIFICANCE
    ahead = alike["difference"] > 0
    return Rank(
        teacher=teacher,
        across=across,
        challenges=int(mine["challenges"]),
        mean=float(mine["difference"]),
        low=float(mine["low"]),
        high=float(mine["high"]),
        n=int(mine["n"]),
        fewest=int(alike["fewest"].min()) if len(alike) else int(mine["n"]),
        rank=1 + int((alike["difference"] < -EQUAL).sum()),
        of=1 + len(alike),
        better=_names(alike[sure & ahead]),
        worse=_names(alike[sure & ~ahead]),
        undecided=_names(alike[~sure]),
        left_out=_names(tests[tests["challenges"] != mine["challenges"]]),
    )


def _names(tests: pd.DataFrame) -> tuple[str, ...]:
    """Returns the others of some tests, Random first, then by name."""
    return tuple(sorted(tests["other"], key=lambda name: (not is_baseline(name), name)))


def _listed(names: tuple[str, ...]) -> str:
    return f"{len(names)} ({listed(map(label, names))})"


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


THRESHOLDS = (25, 50, 75)
"""Per cent of the test tasks, over which the share of runs is told in tables."""

BLOCK = [*ACROSS, "block", "challenges", "of"]
"""Columns that the rows of `overall` have in common that are read together."""

STEPS = tuple(range(0, 100, 2))
"""The same of the curves that are performance profiles."""


def headlines(
    runs: pd.DataFrame, measure: str = MEASURE, teachers: Collection[str] | None = None
) -> list[str]:
    """Returns the differences of teachers to Random over all challenges, a sentence for each verdict.

    Few seeds of one challenge decide little, all challenges together more. A teacher is better or worse where
    p is under 0.05 after Holm's correction for all teachers at that level.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.
        teachers: that are told of; all by default.
    """
    if runs.empty:
        return []
    table = stratified_differences(runs, measure, BASELINE)
    table = table[(table["reason"] == "") & (table["challenges"] > 1)]
    table = table if teachers is None else table[table["teacher"].isin(teachers)]
    table = table.sort_values([*ACROSS, "difference"], ascending=[*[True] * len(ACROSS), False])
    told = {"steps", *varying(table), *(["variant"] if (table["variant"] != "").any() else [])}
    found: dict[str, list[str]] = {}
    for _, row in table.iterrows():
        words = condition_words(row, [name for name in CONDITIONS if name in told])
        where = ", ".join([f"expert knowledge {row['expert_knowledge']}", *words])
        verdict = "not distinguishable from"
        if row["holm"] < SIGNIFICANCE:
            verdict = "better than" if row["difference"] > 0 else "worse than"
        said = f"Over {row['challenges']} challenges ({where}) {verdict} Random, in points"
        found.setdefault(said, []).append(_difference(row))
    return [f"{said}: {'; '.join(teachers)}." for said, teachers in found.items()]


def _difference(row: pd.Series) -> str:
    interval = f"{number(row['difference'])} {ends(row['low'], row['high'])}"
    few = in_brief(row["fewest"]).replace("; ", ", ")
    return f"{label(row['teacher'])} {interval}, {p_value(row['holm'])} after Holm{few}"


def overall(runs: pd.DataFrame, measure: str = MEASURE) -> pd.DataFrame:
    """Returns one row for each teacher at each level and budget, on the same challenges, the best first.

    Teachers are set side by side on the same challenges only: apart from those that have results on all,
    there is a block of rows for each smaller set of challenges that is all that some teacher has, of everyone
    who has these.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        `ACROSS`, block (number of the set of challenges), challenges (number of them), of (number that there
        are), teacher, n, and with their 95 % intervals mean, low_mean, high_mean: mean over challenges of
        equal weight; better, low_better, high_better: probability that a run is better than one of Random on
        the same challenge (Agarwal et al., 2021); worst: result of the worst run, the mean over challenges;
        over_25 and so on: share of runs over so many per cent.
    """
    blocks = [
        _block(part, measure).assign(block=block, challenges=_challenges(part), of=of)
        for _, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True)
        for block, (part, of) in enumerate(on_the_same(group))
    ]
    table = pd.concat(blocks, ignore_index=True) if blocks else pd.DataFrame()
    return table.reindex(columns=list(dict.fromkeys([*BLOCK, "teacher", *table])))


def _challenges(runs: pd.DataFrame) -> int:
    return int(runs.groupby(PLACES, dropna=False).ngroups)


def _block(runs: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns the rows of teachers that have results on the same challenges."""
    by = [*ACROSS, "teacher"]
    table = stratified_means(runs, measure)[[*by, "n", "difference", "low", "high"]]
    table = table.set_axis([*by, "n", "mean", "low_mean", "high_mean"], axis=1)
    chances = improvements(runs, measure, reference=BASELINE, within=ACROSS, strata=CHALLENGES)
    chances = chances.rename(columns={"first": "teacher"})[[*by, "value", "low", "high"]]
    chances = chances.set_axis([*by, "better", "low_better", "high_better"], axis=1)
    lowest = runs.groupby([*by, *CHALLENGES], dropna=False)[measure].min()
    worst = lowest.groupby(by, dropna=False).mean().rename("worst").reset_index()
    shares = profiles(runs, measure, THRESHOLDS, by=by, strata=CHALLENGES)
    wide = shares.pivot_table(index=by, columns="threshold", values="share", dropna=False, observed=True)
    wide = wide.rename(columns={threshold: f"over_{threshold}" for threshold in THRESHOLDS}).reset_index()
    for columns in (chances, worst, wide):
        table = table.merge(columns, on=by, how="left")
    order = [*[True] * len(ACROSS), False]
    return table.sort_values([*ACROSS, "mean"], ascending=order, ignore_index=True)


def overall_rows(runs: pd.DataFrame, measure: str = MEASURE) -> list[dict[str, Any]]:
    """Returns the rows of `overall` as text.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        place, name (of the teacher), teacher (its label), own (True if it is the reader's), colour, n, mean
        and better (with intervals), worst, over (shares of runs over `THRESHOLDS`).
    """
    if runs.empty:
        return []
    table = overall(runs, measure)
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    return [
        {
            "place": place_of(row, told),
            "name": row["teacher"],
            "teacher": marked_label(row["teacher"]),
            "own": mark_of(row["teacher"]) != "",
            "colour": look(row["teacher"]).colour,
            "n": row["n"],
            "mean": interval(row, "mean", 1),
            "better": interval(row, "better", 2),
            "worst": number(row["worst"]),
            "over": " / ".join(number(100 * row[f"over_{threshold}"], 0) for threshold in THRESHOLDS),
        }
        for _, row in table.iterrows()
    ]


def performance_profiles(runs: pd.DataFrame, measure: str = MEASURE) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yields where (level and budget, in words) and the performance profiles of all teachers there.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        Of `aggregates.profiles`, at `STEPS`.
    """
    if runs.empty:
        return
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    for _, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        for part, of in on_the_same(group):
            table = profiles(part, measure, STEPS, by=[*ACROSS, "teacher"], strata=CHALLENGES)
            row = part.iloc[0].copy()
            row["challenges"], row["of"] = _challenges(part), of
            yield place_of(row, told), table


def place_of(row: pd.Series, told: Sequence[str]) -> str:
    """Returns level and conditions of a row of `overall` in words, and its challenges where they are not all.

    Args:
        row: a row of `overall`.
        told: columns of `CONDITIONS` that are said.
    """
    words = [f"expert knowledge {row['expert_knowledge']}", *condition_words(row, told)]
    if row["challenges"] < row["of"]:
        words.append(f"{row['challenges']} of {row['of']} challenges")
    return ", ".join(words)


def interval(row: pd.Series, name: str, digits: int) -> str:
    """Returns the estimate `name` of a row of `overall` with its interval, as text."""
    return estimate(row[name], row[f"low_{name}"], row[f"high_{name}"], digits)
