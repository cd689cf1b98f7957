"""Claims of the paper and its ranking of teachers, held against results."""

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, singledispatch
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import ends, number, p_value
from analysis.measures import pooling
from analysis.measures.tested import PAPERS, Seeds, compared, seeds_to_pair
from analysis.names import label, title
from analysis.statistics import (
    SIGNIFICANCE,
    Comparison,
    Description,
    describe,
    holm,
    mean_percent_interval,
    welch_from_statistics,
)
from analysis.statistics.samples import Standing, contrary, equivalent, greater
from tma_ray.benchmark import MATRICES, PaperResult, paper_results
from tma_ray.benchmark.claims import (
    CLAIMS,
    Bounded,
    Claim,
    Compared,
    Ranked,
    Reading,
    Relation,
    Scaled,
    Statement,
)
from tma_ray.benchmark.experiments import TEACHERS
from tma_ray.results import BOX2D
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Sample:
    """Results for one reading.

    Attributes:
        description: n, mean and std of mastered tasks, in per cent.
        values: one per run, by run id; None where only the description is known.
        seeds: seeds of the runs that are paired by them, by run id.
    """

    description: Description
    values: pd.Series | None = None
    seeds: Seeds = field(default_factory=dict)


class Source(Protocol):
    """Source of the results that statements of claims refer to."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return the results of `reading`; None if they are missing or incomplete."""

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have results where `reading` is read."""


@dataclass(frozen=True)
class Finding:
    """A statement judged by results.

    Attributes:
        standing: standing by an interval against a margin.
        evidence: the numbers behind that, or what is missing.
    """

    standing: Standing
    evidence: str


@dataclass(frozen=True)
class Verdict:
    """A claim judged by results.

    Attributes:
        claim: claim of the paper.
        standing: standing by an interval against a margin.
        findings: one for each of its statements.
    """

    claim: Claim
    standing: Standing
    findings: tuple[Finding, ...]

    def describe(self) -> str:
        """Return the number of statements of each standing, in words."""
        counts = {s: sum(finding.standing is s for finding in self.findings) for s in Standing}
        parts = [f"{counts[Standing.SUPPORTED]} of {len(self.findings)} statements supported"]
        parts += [f"{counts[s]} {s}" for s in Standing if s is not Standing.SUPPORTED and counts[s]]
        if self.claim.needed < len(self.findings):
            parts.append(f"{self.claim.needed} {self.claim.threshold}")
        return ", ".join(parts + ([self.claim.caveat] if self.claim.caveat else []))


def judge(source: Source, claims: Sequence[Claim] = CLAIMS) -> list[Verdict]:
    """Return the standing of each of `claims` by the results of `source`."""
    found = []
    for claim in claims:
        findings = tuple(_finding(statement, source) for statement in claim.statements)
        counts = Counter(finding.standing for finding in findings)
        unknown = counts[Standing.UNDECIDED] + counts[Standing.NO_DATA]
        standing = Standing.NO_DATA if counts[Standing.NO_DATA] == len(findings) else Standing.UNDECIDED
        if counts[Standing.SUPPORTED] >= claim.needed:
            standing = Standing.SUPPORTED
        elif counts[Standing.SUPPORTED] + unknown < claim.needed:
            standing = Standing.REFUTED
        found.append(Verdict(claim, standing, findings))
    return found


@singledispatch
def _finding(statement: Statement, source: Source) -> Finding:
    raise NotImplementedError(f"statements of type {type(statement).__name__}")


@_finding.register
def _(statement: Compared, source: Source) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    test = _test(first, second)
    names = f"{_name(statement.first)} {number(test.difference)} points from {_name(statement.second)}"
    interval = test.reason or f"95 % interval {ends(test.low, test.high)}, {p_value(test.p)}"
    evidence = f"{names} ({interval}, n = {test.n} and {test.reference_n})"
    return Finding(_relation(statement.relation, test), evidence)


@_finding.register
def _(statement: Bounded, source: Source) -> Finding:
    sample = source.sample(statement.reading)
    if sample is None or (statement.best_seed and sample.values is None):
        return _missing(statement.reading)
    if statement.best_seed and sample.values is not None:
        best = float(sample.values.max())
        evidence = f"{_name(statement.reading)}: best seed {number(best)} %, n = {sample.description.n}"
        holds = statement.least <= best <= statement.most
        return Finding(Standing.SUPPORTED if holds else Standing.REFUTED, evidence)
    low, high = mean_percent_interval(sample.description)
    standing = Standing.UNDECIDED
    if statement.least <= low and high <= statement.most:
        standing = Standing.SUPPORTED
    elif low > statement.most or high < statement.least:
        standing = Standing.REFUTED
    mean = f"mean {number(sample.description.mean)} % [{number(low)}, {number(high)}]"
    return Finding(standing, f"{_name(statement.reading)}: {mean}, n = {sample.description.n}")


@_finding.register
def _(statement: Ranked, source: Source) -> Finding:
    samples = {
        teacher: source.sample(replace(statement.reading, teacher=teacher))
        for teacher in source.teachers(statement.reading)
        if teacher in TEACHERS
    }
    known = {teacher: sample for teacher, sample in samples.items() if sample is not None}
    mine = known.pop(statement.reading.teacher, None)
    if mine is None or len(known) < statement.top:
        return _missing(statement.reading)
    ahead = Counter(_relation(Relation.BETTER, _test(other, mine)) for other in known.values())
    standing = Standing.UNDECIDED
    if ahead[Standing.SUPPORTED] >= statement.top:
        standing = Standing.REFUTED
    elif ahead[Standing.SUPPORTED] + ahead[Standing.UNDECIDED] < statement.top:
        standing = Standing.SUPPORTED
    place = 1 + sum(other.description.mean > mine.description.mean for other in known.values())
    evidence = (
        f"{_name(statement.reading)}: place {place} of {len(known) + 1} by mean; better are "
        f"{ahead[Standing.SUPPORTED]} for certain, {ahead[Standing.UNDECIDED]} perhaps"
    )
    return Finding(standing, evidence)


@_finding.register
def _(statement: Scaled, source: Source) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    mine, theirs, factor = first.description, second.description, statement.factor
    test = welch_from_statistics(mine, Description(theirs.n, factor * theirs.mean, factor * theirs.std))
    evidence = (
        f"{_name(statement.first)}: {number(mine.mean)} % and {number(theirs.mean)} %; above {factor:g} "
        f"times that by {number(test.difference)} {ends(test.low, test.high)}"
    )
    return Finding(greater(test.low, test.high, 0.0), evidence)


def _test(first: Sample, second: Sample) -> Comparison:
    if first.values is not None and second.values is not None:
        return compared(first.values, second.values, {**first.seeds, **second.seeds})
    return welch_from_statistics(first.description, second.description)


def _relation(relation: Relation, test: Comparison) -> Standing:
    low, high = test.low, test.high
    match relation:
        case Relation.BETTER:
            return greater(low, high)
        case Relation.NOT_BETTER:
            return contrary(greater(low, high))
        case Relation.WORSE:
            return greater(-high, -low)
        case Relation.LOWER:
            return greater(-high, -low, 0.0)
        case Relation.ALIKE:
            return equivalent(low, high)


def _missing(reading: Reading) -> Finding:
    return Finding(Standing.NO_DATA, f"{_name(reading)}: no complete results")


def _name(reading: Reading) -> str:
    place = [reading.environment] * (reading.environment != "stump_tracks")
    place += [reading.challenge] * (reading.challenge != "original" or not place)
    body = f", {reading.embodiment}" if reading.embodiment else ""
    share = f", after {reading.share:.0%}" if reading.share < 1 else ""
    return f"{label(reading.teacher)} ({' '.join(place).replace('_', ' ')}, {reading.level}{body}{share})"


PLACE = ["environment", "challenge", "expert_knowledge"]
"""Columns that tell results of one place from others."""


USUAL = "the paper's bodies, students and test tasks"
"""Conditions that have no words of their own."""


class PaperSource:
    """The paper's tables; they hold final results, and single bodies of Parkour only."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return n, mean and std of the entry, None where the tables have none."""
        entries = [result for result in _entries(reading) if result.teacher == reading.teacher]
        if reading.share < 1 or not entries:
            return None
        entry = max(entries, key=lambda result: result.seeds)
        return Sample(Description(entry.seeds, entry.mean, entry.std))

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have an entry there."""
        return sorted({result.teacher for result in _entries(reading)})


class RootSource:
    """Complete pools of the runs of one root; Random counts at every level.

    Results under several conditions, such as two budgets or students, are never held against each other:
    in each environment those that complete the most pools count, and of several the largest budget.

    Attributes:
        note: conditions that count, and those that do not, in words; empty where all are alike.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._places = cache(self._complete)
        self._conditions, self.note = _chosen_conditions(pooling.runs_after(frames))
        columns = ["environment", "challenge"]
        self._present = set(frames.cells[columns].itertuples(index=False, name=None))

    def sample(self, reading: Reading) -> Sample | None:
        """Return the runs of the reading; None unless its pool is complete."""
        return self._at(reading).get(reading.teacher)

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have complete results there."""
        return sorted(self._at(reading))

    def _at(self, reading: Reading) -> dict[str, Sample]:
        if (reading.environment, reading.challenge) not in self._present:
            return {}
        place = [reading.environment, reading.challenge, reading.level.value]
        place += [reading.embodiment] if reading.embodiment else []
        return self._places(reading.share, bool(reading.embodiment)).get(tuple(place), {})

    def _complete(self, share: float, by_body: bool) -> dict[tuple[str, ...], dict[str, Sample]]:
        """Return the complete results after a share of the budget, by place, body and teacher."""
        by = ["embodiment"] if by_body else []
        runs = pooling.runs_after(self._frames, share, training=share == 1)  # of which the page shows more
        counted = pd.Series(False, runs.index)
        for environment, conditions in self._conditions.items():
            own = runs["environment"] == environment
            for column, value in conditions.items():
                own &= runs[str(column)].isna() if pd.isna(value) else runs[str(column)] == value
            counted |= own
        runs = runs[counted]
        table, keys = pooling.pooled(runs, [PAPERS], by=by), [*PLACE, "pool", "steps", "teacher", *by]
        members: dict[Any, Any] = runs.groupby(keys, observed=True).indices
        places: dict[tuple[str, ...], dict[str, Sample]] = {}
        for row in table[table["missing"] == ""].sort_values("n", kind="stable").to_dict("records"):
            mine = runs.take(members[tuple(row[key] for key in keys)])
            values = pd.Series(mine[PAPERS].to_numpy(float), mine["run_id"].to_numpy(object)).dropna()
            place = tuple(str(row[column]) for column in (*PLACE, *by))
            if row["engine"] == BOX2D and place[-1] == pooling.RELEASED_BIPEDAL:
                place = (*place[:-1], pooling.BIPEDAL)
            sample = Sample(describe(values), values, seeds_to_pair(mine))
            places.setdefault(place, {})[str(row["teacher"])] = sample
        return places


def _chosen_conditions(runs: pd.DataFrame) -> tuple[dict[str, pd.Series], str]:
    """Return the conditions by which claims about each environment are judged, and words on the others."""
    runs = runs[runs["steps"].notna()]
    if runs.empty:
        return {}, ""
    table = pooling.pooled(runs, [PAPERS])
    table["complete"] = table["missing"] == ""
    places = dict(list(table.groupby("environment")))
    chosen, sentences = {}, []
    for environment, pools in places.items():
        counts = pools.groupby(pooling.CONDITIONS, dropna=False)["complete"].sum().reset_index()
        ordered = counts.sort_values(["complete", "steps"], ascending=False, kind="stable")
        chosen[str(environment)] = ordered.iloc[0][pooling.CONDITIONS]
        if len(ordered) == 1:
            continue
        told = pooling.varying(ordered)
        own, *others = (
            ", ".join(pooling.condition_words(row, told)) or USUAL for _, row in ordered.iterrows()
        )
        about = f" about {title('environment', environment)}" if len(places) > 1 else ""
        apart = " and of ".join(others)
        sentences.append(f"Claims{about} are judged by results of {own} alone; apart stand those of {apart}.")
    return chosen, " ".join(sentences)


def _entries(reading: Reading) -> list[PaperResult]:
    wanted = (reading.environment, reading.challenge, reading.level)
    return [
        result
        for result in paper_results()
        if (result.environment, result.challenge, result.expert_knowledge) == wanted
        and (not reading.embodiment or result.embodiments == (reading.embodiment,))
        and not (result.doubt and not is_baseline(result.teacher))
    ]


def decided(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return the `verdicts` on which the results decide at least one statement."""
    return [verdict for verdict in verdicts if verdict.standing is not Standing.NO_DATA]


def root_verdicts(frames: Frames) -> tuple[list[Verdict], list[str]]:
    """Return the standing of each of the paper's claims by the results of a root, and notes.

    These say which of the results claims are judged by, where there are several kinds.
    """
    source = RootSource(frames)
    return judge(source), [source.note] if source.note else []


FEWEST = 3
"""Teachers that a ranking needs."""


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between two rankings of teachers by mean.

    Attributes:
        environment: name of the environment; empty for the mean over all challenges.
        challenge: name of the challenge; empty for the same.
        level: expert knowledge; None for several.
        teachers: names in both rankings; empty for the mean over all challenges.
        tau: 1 for the same order, -1 for the reverse; NaN if all means of a side are equal.
        low: lower end of its 95 % interval; NaN if a teacher has a single run.
        high: upper end of it.
    """

    environment: str
    challenge: str
    level: KnowledgeLevel | None
    teachers: tuple[str, ...]
    tau: float
    low: float
    high: float


def agreements(frames: Frames) -> list[Agreement]:
    """Return tau for each challenge and level in both, followed by its mean.

    Tau is a mean over pairs of teachers, of 1 for a pair in the same order on both sides and -1 for one in
    the reverse. An order is known of pairs that Welch's tests tell apart on both sides, after Holm's
    correction for all pairs that tau is of; the interval holds all values that the others leave possible.
    So with probability 0.95 or more it holds the tau of the true means, wherever these are: noise moves tau
    towards 0, and draws around noisy means, such as a bootstrap's, move it there once more.
    """
    from scipy import stats  # it takes a second to import

    root, paper = RootSource(frames), PaperSource()
    found, everywhere = [], []
    places = dict.fromkeys((m.environment, m.challenge, level) for m in MATRICES for level in m.levels)
    for environment, challenge, level in places:
        reading = Reading(BASELINE, challenge, level, environment)
        names = sorted(set(root.teachers(reading)) & set(paper.teachers(reading)))
        sides = [
            [source.sample(replace(reading, teacher=name)) for name in names] for source in (root, paper)
        ]
        pairs = [
            (name, mine.description, theirs.description)
            for name, mine, theirs in zip(names, *sides, strict=True)
            if mine is not None and theirs is not None
        ]
        if len(pairs) < FEWEST:
            continue
        ours, papers = [mine for _, mine, _ in pairs], [theirs for *_, theirs in pairs]
        tau = float(stats.kendalltau(*([each.mean for each in side] for side in (ours, papers))).statistic)
        orders = pairs_in_both(ours, papers)
        teachers = tuple(name for name, *_ in pairs)
        found.append(Agreement(environment, challenge, level, teachers, tau, *tau_interval([orders])))
        everywhere.append(orders)
    if len(found) > 1:
        mean = float(np.mean([each.tau for each in found]))
        found.append(Agreement("", "", None, (), mean, *tau_interval(everywhere)))
    return found


def pairs_in_both(
    first: Sequence[Description], second: Sequence[Description]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the agreement of each pair of teachers (n,), 1 in the same order or -1, and its p-value.

    The order of a pair is known in both samples of the same teachers where it is in each: p is the larger.
    """
    tests = [
        [welch_from_statistics(*pair) for pair in itertools.combinations(side, 2)] for side in (first, second)
    ]
    signs = np.prod([[np.sign(test.difference) for test in side] for side in tests], axis=0)
    return signs, np.max([[test.p for test in side] for side in tests], axis=0)


def tau_interval(
    challenges: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> tuple[float, float]:
    """Return the ends of the interval of tau, of its mean for several challenges, each of `pairs_in_both`."""
    if any(np.isnan(p).all() for _, p in challenges):
        return float("nan"), float("nan")
    known = np.split(
        holm(np.concatenate([p for _, p in challenges])) < SIGNIFICANCE,
        np.cumsum([len(p) for _, p in challenges])[:-1],
    )
    parts = zip(challenges, known, strict=True)
    low, high = np.mean(
        [[np.where(sure, signs, end).mean() for end in (-1, 1)] for (signs, _), sure in parts], axis=0
    )
    return float(low), float(high)
