"""Views of the frame over all challenges at once: ranks, leaderboards, and differences to Random.

`runs` are rows of `pooling.pool_runs` everywhere, and `measure` is a column of them, in per cent.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.comparisons.aggregates import improvements, profiles, stratified_means
from analysis.comparisons.frame import ACROSS, CHALLENGES, PLACES, from_both_sides, over_challenges, verdict
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import amount, ends, estimate, in_brief, listed, number, p_value
from analysis.measures.evaluations import NEARLY_ALL, trained_shares
from analysis.measures.pooling import CONDITIONS, PARTS, condition_words, runs_after, varying
from analysis.measures.tested import FINAL, HEADLINE
from analysis.names import challenge_title, label, title
from analysis.statistics import SIGNIFICANCE, holm

EQUAL = 1e-9
"""Difference of means, in points, below which two teachers share a rank."""

VERDICTS = {
    "better": "better than",
    "worse": "worse than",
    "not distinguishable": "not distinguishable from",
}
"""Verdicts of `frame.verdict`, and the words before the other teacher."""

THRESHOLDS = (25, 50, 75)
"""Per cent of the test tasks, over which the share of runs is told in tables."""


BLOCK = [*ACROSS, "block", "challenges", "of"]
"""Columns that the rows of `overall` have in common that are read together."""


@dataclass(frozen=True)
class Rank:
    """A teacher's rank among those that have results on all of its challenges.

    Attributes:
        teacher: name of the teacher.
        across: values of `ACROSS`, what all that are ranked have in common.
        challenges: number of challenges.
        mean: mastered test tasks in per cent, the mean over challenges of equal weight.
        low: lower end of its 95 % interval; NaN with one run on a challenge.
        high: upper end of it.
        n: runs.
        fewest: runs on one challenge, of this or another ranked teacher, at least.
        rank: 1 for the highest mean.
        of: number of teachers that are ranked.
        better: those that it is better than, with p < 0.05 after Holm's correction.
        worse: those that it is worse than, with p < 0.05 after the same correction.
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
        """Return rank and verdicts in one sentence."""
        variant = f", {self.across['variant']}" if self.across["variant"] else ""
        where = f"expert knowledge {self.across['expert_knowledge']}, {amount(self.across['steps'])} steps"
        over = f"Over {self.challenges} challenge{'s' if self.challenges > 1 else ''} ({where}{variant})"
        if self.of == 1:
            return (
                f"{over} {label(self.teacher)} has no rank: no other teacher has results on the same "
                f"challenges under the same conditions."
            )
        best, worst = self.best, self.worst
        certain = f"and the tests leave {best} to {worst} open" if best < worst else "as the tests confirm"
        parts = (
            ("better than", self.better),
            ("worse than", self.worse),
            ("undecided against", self.undecided),
        )
        said = "; ".join(f"{words} {_listed(names)}" for words, names in parts if names)
        lacking = f"; not ranked, lacking challenges: {_listed(self.left_out)}" if self.left_out else ""
        return (
            f"{over} {label(self.teacher)} ranks {self.rank} of {self.of} by mean, {certain}: {said} "
            f"(p < {SIGNIFICANCE} after Holm for all pairs{in_brief(self.fewest)}){lacking}."
        )


def ranks(runs: pd.DataFrame, teachers: Collection[str] | None = None, measure: str = HEADLINE) -> list[Rank]:
    """Return the rank of each teacher, or of `teachers` alone, at each level and budget, the best first.

    One family at each, corrected by Holm: the tests of the pairs of which one is looked at, and of which the
    other has results on all of its challenges. What is not ranked is not in the family.
    """
    found: list[Rank] = []
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        means = {row["teacher"]: row for row in stratified_means(group, measure).to_dict("records")}
        looked = [name for name in means if teachers is None or name in teachers]
        tests = from_both_sides(over_challenges(group, measure))
        tests = tests[tests["first"].isin(looked)]
        own = {name: mean["challenges"] for name, mean in means.items()}
        tests = tests.assign(ranked=tests["challenges"] == tests["first"].map(own))
        family = tests.loc[tests["ranked"], "p"].astype(float)
        family = family[~family.index.duplicated()]  # the index of a pair is the same from both sides
        tests["holm"] = pd.Series(holm(family), family.index).reindex(tests.index).to_numpy(float)
        here = []
        for name in looked:
            mine, others = means[name], tests[tests["first"] == name]
            alike = others[others["ranked"]]
            said: dict[str, list[str]] = {word: [] for word in VERDICTS}
            for row in alike.to_dict("records"):
                said[verdict({**row, "reason": ""})].append(row["second"])
            named = (*said.values(), others.loc[~others["ranked"], "second"])
            better, worse, undecided, left_out = (
                tuple(sorted(each, key=lambda who: (not is_baseline(who), who))) for each in named
            )
            rank = Rank(
                teacher=str(name),
                across=dict(zip(ACROSS, key, strict=True)),
                challenges=int(mine["challenges"]),
                mean=float(mine["difference"]),
                low=float(mine["low"]),
                high=float(mine["high"]),
                n=int(mine["n"]),
                fewest=int(alike["fewest"].min()) if len(alike) else int(mine["n"]),
                rank=1 + int((alike["difference"] < -EQUAL).sum()),
                of=1 + len(alike),
                better=better,
                worse=worse,
                undecided=undecided,
                left_out=left_out,
            )
            here.append(rank)
        found += sorted(here, key=lambda rank: (-rank.mean, rank.teacher))
    return found


def _listed(names: tuple[str, ...]) -> str:
    return f"{len(names)} ({listed(map(label, names))})"


@dataclass(frozen=True)
class Entry:
    """A teacher of a leaderboard.

    Attributes:
        rank: rank over all of its challenges by the headline, with the ranks that the tests leave open.
        final: mastered test tasks in per cent at the last three evaluations, the mean over challenges.
        results: headline in per cent by the title of the challenge: mean, and both ends of its 95 %
            interval; these NaN where runs have no spread.
        hours: median wall-clock time of a run, all its attempts together; NaN if unknown.
        trained: median share of the steps from which the student learned, in per cent; NaN if unknown.
    """

    rank: Rank
    final: float
    results: dict[str, tuple[float, float, float]]
    hours: float
    trained: float


@dataclass(frozen=True)
class Leaderboard:
    """Teachers with results on the same challenges, at one level of expert knowledge and one budget.

    Attributes:
        title: level, budget and engine, environments or further conditions where these alone tell it from
            another, and number of challenges where that is not all.
        challenges: titles, in the order of the columns.
        entries: teachers, the best first.
    """

    title: str
    challenges: tuple[str, ...]
    entries: tuple[Entry, ...]

    @property
    def timed(self) -> bool:
        """True if the hours of any run are known; those of simulated students are not."""
        return any(not math.isnan(entry.hours) for entry in self.entries)

    @property
    def partly_trained(self) -> bool:
        """True if the student of any teacher does not learn from all steps."""
        return any(entry.trained < NEARLY_ALL for entry in self.entries)


def leaderboards(frames: Frames) -> list[Leaderboard]:
    """Return leaderboards for each level of expert knowledge and budget, those with most runs first.

    Next to the leaderboard of the teachers that have results on all challenges there is one for each smaller
    set, as `on_the_same` has them. Of runs that have not ended nothing counts.
    """
    found: dict[tuple[str, ...], list[Leaderboard]] = {}
    runs = runs_after(frames).dropna(subset=HEADLINE)
    for where, part in _blocks(runs, HEADLINE):
        board = _board(where, part, frames, _told_apart(where, part, runs))
        found.setdefault(tuple(str(where[name]) for name in ACROSS), []).append(board)
    ordered = sorted(found.values(), key=lambda boards: -sum(e.rank.n for b in boards for e in b.entries))
    return [board for boards in ordered for board in boards]


def _blocks(runs: pd.DataFrame, measure: str) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Yield the values of `BLOCK` and the runs of each set of challenges that teachers share."""
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        for block, (part, of) in enumerate(on_the_same(group)):
            challenges = int(part.groupby(PLACES, dropna=False).ngroups)
            yield dict(zip(BLOCK, (*key, block, challenges, of), strict=True)), part


def on_the_same(runs: pd.DataFrame) -> Iterator[tuple[pd.DataFrame, int]]:
    """Yield the runs of each set of challenges, the largest first, and the number of all challenges.

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


def _told_apart(where: Mapping[str, Any], part: pd.DataFrame, runs: pd.DataFrame) -> list[str]:
    """Return the environments and conditions of `part` in words, where others of `runs` differ in no more."""
    for name in ("expert_knowledge", "steps", "engine", "physics_version"):
        runs = runs[runs[name].astype(str) == str(where[name])]
    places = sorted(part["environment"].unique())
    here = runs[runs["environment"].isin(places)]
    words = [title("environment", tuple(places))] if len(here) < len(runs) else []
    return [*words, *condition_words(pd.Series(where), varying(here, ["mastery_threshold", "variant"]))]


def _board(
    where: Mapping[str, Any], runs: pd.DataFrame, frames: Frames, told_apart: Sequence[str]
) -> Leaderboard:
    results: dict[str, dict[str, tuple[float, float, float]]] = {}
    titles: dict[str, None] = {}
    for row in stratified_means(runs, HEADLINE, [*ACROSS, *PLACES]).to_dict("records"):
        place, challenge = str(row["environment"]), str(row["challenge"])
        name = challenge_title(place, challenge, f"{place} {challenge}")
        titles.setdefault(name)
        result = float(row["difference"]), float(row["low"]), float(row["high"])
        results.setdefault(str(row["teacher"]), {})[name] = result
    final = stratified_means(runs, FINAL).set_index("teacher")["difference"]
    shares = trained_shares(frames)
    spent = runs.drop_duplicates(["teacher", "run_id"])
    spent = spent.assign(hours=spent["run_id"].map(frames.run_hours), trained=spent["run_id"].map(shares))
    usual = spent.groupby("teacher")[["hours", "trained"]].median()  # a few stalled runs would decide a mean
    ranked = {rank.teacher: rank for rank in ranks(runs)}
    entries = tuple(
        Entry(rank, float(final[name]), results[name], *map(float, usual.loc[name]))
        for name, rank in sorted(ranked.items(), key=lambda each: (each[1].rank, each[0]))
    )
    version, challenges = where["physics_version"], where["challenges"]
    engine = f"{where['engine']} {version:g}" if version else where["engine"]
    budget = f"{amount(where['steps'])} steps"
    heading = ", ".join([f"expert knowledge {where['expert_knowledge']}", budget, engine, *told_apart])
    if challenges < where["of"]:
        heading += f": the {len(entries)} teachers on {challenges} of {where['of']} challenges"
    return Leaderboard(heading, tuple(titles), entries)


def headlines(
    runs: pd.DataFrame, measure: str = HEADLINE, teachers: Collection[str] | None = None
) -> list[str]:
    """Return the differences of teachers to Random over all challenges, a sentence for each verdict.

    Few seeds of one challenge decide little, all challenges together more. A teacher is better or worse where
    p is under 0.05 after Holm's correction for all teachers at that level; sentences are on `teachers` alone.
    """
    if runs.empty:
        return []
    table = over_challenges(runs, measure, BASELINE)
    table = table[(table["reason"] == "") & (table["challenges"] > 1)]
    table = table if teachers is None else table[table["first"].isin(teachers)]
    table = table.sort_values([*ACROSS, "difference"], ascending=[*[True] * len(ACROSS), False])
    told = {"steps", *varying(table), *(["variant"] if (table["variant"] != "").any() else [])}
    found: dict[str, list[str]] = {}
    for _, row in table.iterrows():
        words = condition_words(row, [name for name in CONDITIONS if name in told])
        where = ", ".join([f"expert knowledge {row['expert_knowledge']}", *words])
        than = VERDICTS[verdict(row)]
        said = f"Over {row['challenges']} challenges ({where}) {than} Random, in points"
        gap = f"{label(row['first'])} {number(row['difference'])} {ends(row['low'], row['high'])}"
        few = in_brief(row["fewest"]).replace("; ", ", ")
        found.setdefault(said, []).append(f"{gap}, {p_value(row['holm'])} after Holm{few}")
    return [f"{said}: {'; '.join(differences)}." for said, differences in found.items()]


def overall(runs: pd.DataFrame, measure: str = HEADLINE) -> pd.DataFrame:
    """Return one row for each teacher at each level and budget, on the same challenges, the best first.

    Teachers are set side by side on the same challenges only: apart from those that have results on all,
    there is a block of rows for each smaller set, as `on_the_same` has them.

    Returns:
        `ACROSS`, block (number of the set of challenges), challenges (number of them), of (number that there
        are), teacher, n, and with their 95 % intervals mean, low_mean, high_mean: mean over challenges of
        equal weight; better, low_better, high_better: probability that a run is better than one of Random on
        the same challenge (Agarwal et al., 2021); final: the same mean of the last three evaluations; worst:
        result of the worst run, the mean over challenges; over_25 and so on: share of runs over so many per
        cent.
    """
    by, found = [*ACROSS, "teacher"], []
    for where, part in _blocks(runs, measure):
        means = stratified_means(part, measure)[[*by, "n", "difference", "low", "high"]]
        chances = improvements(part, measure, BASELINE, ACROSS, CHALLENGES)
        chances = chances[[*ACROSS, "first", "value", "low", "high"]]
        final = means[by].assign(final=math.nan)
        if FINAL in part:
            final = stratified_means(part, FINAL)[[*by, "difference"]].set_axis([*by, "final"], axis=1)
        lowest = part.groupby([*by, *CHALLENGES], dropna=False)[measure].min()
        shares = profiles(part, measure, THRESHOLDS, by=by, strata=CHALLENGES)
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
        found.append(table.assign(**{name: where[name] for name in ("block", "challenges", "of")}))
    table = pd.concat(found, ignore_index=True) if found else pd.DataFrame()
    return table.reindex(columns=list(dict.fromkeys([*BLOCK, "teacher", *table])))


def overall_rows(runs: pd.DataFrame, measure: str = HEADLINE) -> list[dict[str, Any]]:
    """Return the rows of `overall` as text.

    Returns:
        block, place, name (of the teacher), n, mean and better (with intervals), final, worst, over (shares
        of runs over `THRESHOLDS`).
    """
    rows, told = [], _told(runs)
    for row in overall(runs, measure).to_dict("records"):
        name = str(row["teacher"])
        better = estimate(row["better"], row["low_better"], row["high_better"], 2)
        rows.append(
            {
                "block": row["block"],
                "place": _place_of(pd.Series(row), told),
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
    """Yield level and budget, in words, and rows of `profiles` of all teachers there, every 2 per cent."""
    for where, part in _blocks(runs, measure):
        table = profiles(part, measure, range(0, 100, 2), by=[*ACROSS, "teacher"], strata=CHALLENGES)
        yield _place_of(pd.Series(where), _told(runs)), table


def _told(runs: pd.DataFrame) -> list[str]:
    """Return the conditions that titles name: the budget, and those that vary."""
    return list(dict.fromkeys(["steps", *varying(runs)])) if len(runs) else []


def _place_of(row: pd.Series, told: Sequence[str]) -> str:
    """Return level and conditions of a block in words, and its challenges where they are not all."""
    words = [f"expert knowledge {row['expert_knowledge']}", *condition_words(row, told)]
    if row["challenges"] < row["of"]:
        words.append(f"{row['challenges']} of {row['of']} challenges")
    return ", ".join(words)
