"""Leaderboards of teachers over all challenges, with estimates for each teacher.

In all functions `runs` are rows from `pooling.pool_runs`, and `measure` is a column of them, in per cent.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.against_random import AgainstRandom, Gap, against_random
from analysis.comparisons.aggregates import improvements, profiles, stratified_means
from analysis.comparisons.pairwise import pairwise
from analysis.comparisons.ranks import Rank, ranks
from analysis.data.columns import ACROSS, CHALLENGE, PARTS, STRATA
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import estimate, few_seeds_warning, listed, number, steps_text
from analysis.measures.pooling import (
    condition_words,
    levels_together,
    runs_after,
    varying,
    without_common_phrases,
)
from analysis.measures.run_measures import trained_shares
from analysis.measures.tested import AXES, FINAL, HEADLINE, TRAINED
from analysis.names import challenge_title, distinct_labels, label, mark_of, title
from tma_ray.support.component_names import split_name

THRESHOLDS = (25, 50, 75)
"""Percentages of mastered test tasks above which tables count runs."""

BLOCK_COLUMNS = [*ACROSS, "block", "challenges", "of"]
"""Columns that identify a block of rows of `overall`: the teachers on one set of challenges."""

CREDIBLE = 0.95
"""Minimum probability that the teachers of `Leaderboard.best` include the best one."""


@dataclass(frozen=True)
class Entry:
    """Row of a leaderboard: ranks and results of a teacher.

    Attributes:
        ranks: rank over all challenges by each of `AXES`.
        against: comparison with Random; None for Random, and without results of Random.
        results: mean in per cent and both ends of its 95 % interval by each of `AXES` and by title of
            `Leaderboard.columns`; ends are NaN if runs have no spread.
        trained: median share of the steps from which the student learned, in per cent; NaN if unknown.
    """

    ranks: Mapping[str, Rank]
    against: AgainstRandom | None
    results: Mapping[str, Mapping[str, tuple[float, float, float]]]
    trained: float

    @property
    def teacher(self) -> str:
        """Name of the teacher."""
        return self.ranks[HEADLINE].teacher


@dataclass(frozen=True)
class Leaderboard:
    """Teachers with results on the same challenges, at one level of expert knowledge and one budget.

    Attributes:
        title: level, budget and engine; environment and conditions if they differ between leaderboards;
            number of challenges if it is not all of them.
        challenges: titles of the challenges.
        bodies: titles of the bodies if there is one challenge with several, such as Parkour's; else empty.
        entries: teachers, the best in the end first.
        names: shortest distinct label of each teacher; see `names.distinct_labels`.
        runs: its rows from `pooling.pool_runs`.
        budget_notes: sentences about the agreement of its order with those at longer budgets.
    """

    title: str
    challenges: tuple[str, ...]
    bodies: tuple[str, ...]
    entries: tuple[Entry, ...]
    names: Mapping[str, str]
    runs: pd.DataFrame = field(repr=False, compare=False)
    budget_notes: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Titles of the columns of results: challenges and bodies."""
        return (*self.challenges, *self.bodies)

    @property
    def newcomers(self) -> bool:
        """True if any teacher is not in the core."""
        return any(entry.ranks[HEADLINE].newcomer for entry in self.entries)

    def best(self, axis: str) -> dict[str, float]:
        """Return the smallest credible set for the best teacher, with the probability of each member.

        It is empty if probabilities are unknown, for lack of a second seed.
        """
        chances = {entry.teacher: entry.ranks[axis].chance for entry in self.entries}
        best: dict[str, float] = {}
        for teacher in sorted(chances, key=lambda name: -chances[name]):
            if sum(best.values()) < CREDIBLE and not math.isnan(chances[teacher]):
                best[teacher] = chances[teacher]
        return best

    def answer(self) -> str:
        """Return two sentences about the best teachers: over training, and at the end."""
        if len(self.entries) < 2:
            return ""
        leaders = {axis: self.best(axis) for axis in AXES}
        texts = {axis: self._named(chances) for axis, chances in leaders.items() if chances}
        if not all(leaders.values()):
            first = "With a single seed in a cell no teacher can be called the best"
        elif leaders[HEADLINE].keys() == leaders[FINAL].keys():
            first = f"The best teacher, sooner and in the end, is {texts[FINAL]}"
        else:
            first = f"The best teacher in the end is {texts[FINAL]}; the soonest is {texts[HEADLINE]}"
        by_end = {entry.teacher: number(entry.ranks[FINAL].mean) for entry in self.entries}
        others = [teacher for teacher in by_end if teacher not in leaders[FINAL]]
        shown = [*leaders[FINAL], *others[:1], *(name for name in others[1:] if is_baseline(name))]
        means = (f"{self.names[teacher]} {by_end[teacher]} %" for teacher in shown)
        return f"{first}. Mastered test tasks in the end: {', '.join(means)}."

    def marked(self, entry: Entry) -> str:
        """Return a teacher's name with the marks of its footnotes (see `notes`) and of `names.mark_of`."""
        partly = bool(entry.against and TRAINED in entry.against.gaps)
        marks = "*" * entry.ranks[HEADLINE].newcomer + "†" * partly
        return f"{self.names[entry.teacher]}{' ' * bool(marks)}{marks}{mark_of(entry.teacher)}"

    def on_each_challenge(self, axis: str) -> dict[tuple[str, str], Gap]:
        """Return the differences from Random in a measure, by teacher and title of `columns`.

        In each column the tests of the core against Random are a family, and so is that of each newcomer.
        """
        return {
            (str(test["first"]), title): Gap.of(test)
            for title, runs in (_by_challenge(self.runs) | _by_body(self.runs)).items()
            for _, test in pairwise(runs, axis, BASELINE, detectable=False).iterrows()
            if test["second"] in self.names
        }

    def _named(self, chances: Mapping[str, float]) -> str:
        *others, last = (self.names[teacher] for teacher in chances)
        names = f"{', '.join(others)} or {last}" if others else last
        chance = f"probability {number(min(sum(chances.values()), 0.99), 2)}"
        return f"{names} ({chance}{', not distinguishable' if len(chances) > 1 else ''})"


def notes(board: Leaderboard) -> list[str]:
    """Return the notes below a leaderboard: trained steps, omitted settings, few seeds, longer budgets."""
    sentences = []
    gaps = [(entry, entry.against.gaps) for entry in board.entries if entry.against]
    parts = [
        f"{board.names[entry.teacher]} {gap} ({gap.verdict}; {number(entry.trained, 0)} % trained)"
        for entry, by_measure in gaps
        if (gap := by_measure.get(TRAINED))
    ]
    if parts:
        sentences.append(f"† Per trained step, beside Random, over training: {'; '.join(parts)}.")
    if board.newcomers:
        sentences.append("* Joined later: ranked with the core by its own tests.")
    shortened = [teacher for teacher, name in board.names.items() if name != label(teacher)]
    if shortened:
        left_out: dict[str, list[str]] = {}
        for teacher in sorted(shortened, key=label):
            full, short = split_name(teacher)[1], board.names[teacher]
            settings = (f"{key}={value}" for key, value in full.items() if f"{key}={value}" not in short)
            left_out.setdefault(", ".join(settings), []).append(short)
        words = "; ".join(f"{settings} of {', '.join(names)}" for settings, names in left_out.items())
        fitted = " With budget= settings fit the steps of a run; those of the core's teachers do not."
        sentences.append(f"Settings left out of names: {words}.{fitted if 'budget=' in words else ''}")
    runs = [(entry, entry.ranks[HEADLINE]) for entry in board.entries]
    usual, _ = Counter(rank.n for _, rank in runs).most_common(1)[0]
    few = few_seeds_warning(min(rank.fewest for _, rank in runs if rank.n >= usual))
    fewer = listed(board.names[entry.teacher] for entry, rank in runs if rank.n < usual)
    sentences += [f"{few}{f' Fewer runs: {fewer}.' if fewer else ''}"] if few else []
    return [*sentences, *board.budget_notes]


def leaderboards(
    frames: Frames, runs: pd.DataFrame | None = None, *, subsets: bool = True
) -> list[Leaderboard]:
    """Return the leaderboards for each level of expert knowledge and budget, in descending order of runs.

    Besides the leaderboard of teachers with results on all challenges there is one for each set of
    `challenge_sets`. Only runs that have ended count. Levels with the same runs are one.

    Args:
        frames: results from `load`.
        runs: rows from `pooling.runs_after`; those at the ends of runs by default.
        subsets: True for the smaller sets of challenges, too.
    """
    boards: dict[tuple[str, ...], list[Leaderboard]] = {}
    conditions = [column for column in ACROSS if column != "expert_knowledge"]
    runs = runs_after(frames, training=False) if runs is None else runs
    runs = levels_together(runs.dropna(subset=HEADLINE), conditions)
    for where, part in _blocks(runs, HEADLINE):
        if where["block"] and not subsets:
            continue
        board = _board(_heading(where, part, runs), part, frames)
        boards.setdefault(tuple(str(where[name]) for name in ACROSS), []).append(board)
    ordered = sorted(
        boards.values(), key=lambda group: -sum(e.ranks[HEADLINE].n for b in group for e in b.entries)
    )
    return [board for group in ordered for board in group]


def _blocks(runs: pd.DataFrame, measure: str) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Yield, for each block (teachers on the same challenges), the values of `BLOCK_COLUMNS` and the runs."""
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        for block, (part, of) in enumerate(challenge_sets(group)):
            challenges = int(part.groupby(CHALLENGE, dropna=False).ngroups)
            yield dict(zip(BLOCK_COLUMNS, (*key, block, challenges, of), strict=True)), part


def challenge_sets(runs: pd.DataFrame) -> Iterator[tuple[pd.DataFrame, int]]:
    """Yield the runs on each set of challenges, largest set first, with the total number of challenges.

    A set consists of the challenges on which some teacher has runs of all bodies and students; its runs are
    those of all teachers that have these challenges.
    """
    challenges = runs.groupby(CHALLENGE, dropna=False, sort=True).ngroup()
    parts = runs.groupby([*CHALLENGE, *PARTS], dropna=False, sort=True).ngroup()
    expected = parts.groupby(challenges).nunique()
    held: dict[str, frozenset[int]] = {}
    for teacher, numbers in parts.groupby(runs["teacher"]):
        counts = numbers.groupby(challenges).nunique()
        held[str(teacher)] = frozenset(counts.index[counts == expected[counts.index]])
    for chosen in sorted(set(held.values()) - {frozenset()}, key=lambda some: (-len(some), sorted(some))):
        teachers = [teacher for teacher, complete in held.items() if complete >= chosen]
        yield runs[challenges.isin(chosen) & runs["teacher"].isin(teachers)], len(expected)


def _heading(where: Mapping[str, Any], part: pd.DataFrame, runs: pd.DataFrame) -> str:
    """Return the title of the leaderboard of `part`, one of those of `runs`."""
    version, challenges = where["physics_version"], where["challenges"]
    phrases = [
        *_environment(part, runs),
        f"expert knowledge {where['expert_knowledge']}",
        f"{steps_text(where['steps'])} steps",
        f"{where['engine']} {version:g}" if version else where["engine"],
        *_distinction(where, part, runs),
    ]
    heading = ", ".join(phrases)
    if challenges == where["of"]:
        return heading
    teachers = part["teacher"].nunique()
    return f"{heading}: the {teachers} teachers on {challenges} of {where['of']} challenges"


def _environment(part: pd.DataFrame, runs: pd.DataFrame) -> list[str]:
    """Return a phrase with the environments of `part`, or nothing if `runs` have the same ones."""
    environments = sorted(part["environment"].unique())
    whole = len(environments) == runs["environment"].nunique()
    return [] if whole else [title("environment", tuple(environments))]


def _distinction(where: Mapping[str, Any], part: pd.DataFrame, runs: pd.DataFrame) -> list[str]:
    """Return phrases for the conditions that distinguish `part` from the other `runs`."""
    for name in ("expert_knowledge", "steps", "engine", "physics_version"):
        runs = runs[runs[name].astype(str) == str(where[name])]
    same = runs[runs["environment"].isin(part["environment"].unique())]
    shorter = without_common_phrases(same["variant"])[part.index[0]]
    conditions = pd.Series({**where, "variant": shorter})
    return condition_words(conditions, varying(same, ["mastery_threshold", "variant"]))


def _board(heading: str, runs: pd.DataFrame, frames: Frames) -> Leaderboard:
    by_challenge, by_body = _by_challenge(runs), _by_body(runs)
    results: dict[str, dict[str, dict[str, tuple[float, float, float]]]] = {}
    for axis, (name, part) in itertools.product(AXES, (by_challenge | by_body).items()):
        for row in stratified_means(part, axis, [*ACROSS, *CHALLENGE]).to_dict("records"):
            by_axis = results.setdefault(str(row["teacher"]), {axis: {} for axis in AXES})
            by_axis[axis][name] = float(row["difference"]), float(row["low"]), float(row["high"])
    shares = runs["run_id"].map(trained_shares(frames)).groupby(runs["teacher"]).median()
    ranked = {axis: {rank.teacher: rank for rank in ranks(runs, measure=axis)} for axis in AXES}
    compared = {gaps.teacher: gaps for gaps in against_random(frames, runs)}
    entries = tuple(
        Entry(
            ranks={axis: by_name[teacher] for axis, by_name in ranked.items()},
            against=compared.get(teacher),
            results=results[teacher],
            trained=float(shares[teacher]),
        )
        for teacher in sorted(ranked[FINAL], key=lambda name: (-ranked[FINAL][name].mean, name))
    )
    budget_notes = frames.cells.loc[frames.cells["run_id"].isin(runs["run_id"]), "budget_note"].unique()
    return Leaderboard(
        title=heading,
        challenges=tuple(by_challenge),
        bodies=tuple(by_body),
        entries=entries,
        names=distinct_labels(results),
        runs=runs,
        budget_notes=tuple(filter(None, budget_notes)),
    )


def _by_challenge(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs on each challenge, by its title."""
    titles = [challenge_title(*key) for key in zip(runs["environment"], runs["challenge"], strict=True)]
    return {str(name): part for name, part in runs.groupby(np.array(titles, dtype=object))}


def _by_body(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs of each body, by its title, if there is one challenge with several bodies."""
    several = runs["embodiment"].nunique() > 1
    if not several or len(runs[["environment", "challenge"]].drop_duplicates()) > 1:
        return {}
    return {title("embodiment", body): part for body, part in runs.groupby("embodiment", sort=True)}


def overall(runs: pd.DataFrame, measure: str = HEADLINE) -> pd.DataFrame:
    """Return estimates over shared challenges, one row per teacher, level and budget, best teacher first.

    Teachers are compared on the same challenges only, in a block of rows for each of `challenge_sets`.

    Returns:
        `ACROSS`, block (number of the set of challenges), challenges (their number), of (number of all),
        place (title of the block), teacher, n, and with their 95 % intervals mean, low_mean, high_mean: mean
        over challenges of equal weight; better, low_better, high_better: probability that a run is better
        than one of Random on the same challenge (Agarwal et al., 2021); final: the same mean of the last
        three evaluations; worst: result of the worst run, the mean over challenges; over_25, over_50,
        over_75: share of runs above that percentage.
    """
    by, tables = [*ACROSS, "teacher"], []
    for where, place, part in _titled_blocks(runs, measure):
        means = stratified_means(part, measure)[[*by, "n", "difference", "low", "high"]]
        chances = improvements(part, measure, BASELINE, ACROSS, STRATA)
        chances = chances[[*ACROSS, "first", "value", "low", "high"]]
        final = means[by].assign(final=math.nan)
        if FINAL in part:
            final = stratified_means(part, FINAL)[[*by, "difference"]].set_axis([*by, "final"], axis=1)
        lowest = part.groupby([*by, *STRATA], dropna=False)[measure].min()
        shares = profiles(part, measure, THRESHOLDS, by=by, strata=STRATA)
        wide = shares.pivot_table(index=by, columns="threshold", values="share", dropna=False, observed=True)
        table = means.set_axis([*by, "n", "mean", "low_mean", "high_mean"], axis=1)
        for columns in (
            chances.set_axis([*by, "better", "low_better", "high_better"], axis=1),
            final,
            lowest.groupby(by, dropna=False).mean().rename("worst").reset_index(),
            wide.add_prefix("over_").reset_index(),
        ):
            table = table.merge(columns, on=by, how="left")
        order = [*[True] * len(ACROSS), False]
        table = table.sort_values([*ACROSS, "mean"], ascending=order, ignore_index=True)
        block = {name: where[name] for name in ("block", "challenges", "of")}
        tables.append(table.assign(**block, place=place))
    table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return table.reindex(columns=list(dict.fromkeys([*BLOCK_COLUMNS, "place", "teacher", *table])))


def overall_rows(runs: pd.DataFrame, measure: str = HEADLINE) -> list[dict[str, Any]]:
    """Return the rows of `overall`, formatted for tables.

    Returns:
        block, place, name (of the teacher), n, mean and better (with intervals), final, worst, over (shares
        of runs above `THRESHOLDS`).
    """
    rows = []
    for row in overall(runs, measure).to_dict("records"):
        name = str(row["teacher"])
        better = estimate(row["better"], row["low_better"], row["high_better"], 2)
        rows.append(
            {
                "block": row["block"],
                "place": row["place"],
                "name": name,
                "n": row["n"],
                "mean": estimate(row["mean"], row["low_mean"], row["high_mean"], 1),
                "final": number(row["final"]),
                "better": "" if is_baseline(name) else better,
                "worst": number(row["worst"]),
                "over": "/".join(number(100 * row[f"over_{threshold}"], 0) for threshold in THRESHOLDS),
            }
        )
    return rows


def performance_profiles(runs: pd.DataFrame, measure: str = HEADLINE) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the title and the performance profiles (in steps of 2 %) of each block of teachers."""
    for _, heading, part in _titled_blocks(runs, measure):
        yield heading, profiles(part, measure, range(0, 100, 2), by=[*ACROSS, "teacher"], strata=STRATA)


def _titled_blocks(runs: pd.DataFrame, measure: str) -> Iterator[tuple[Mapping[str, Any], str, pd.DataFrame]]:
    """Yield `_blocks` with their titles: environment, level, conditions, number of challenges if not all."""
    named = [name for name in dict.fromkeys(["steps", *varying(runs)]) if name != "variant"]
    for where, part in _blocks(runs, measure):
        words = [*_environment(part, runs), f"expert knowledge {where['expert_knowledge']}"]
        words += [*condition_words(pd.Series(where), named), *_distinction(where, part, runs)]
        if where["challenges"] < where["of"]:
            words.append(f"{where['challenges']} of {where['of']} challenges")
        yield where, ", ".join(dict.fromkeys(words)), part
