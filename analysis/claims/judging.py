"""Tests of the paper's claims against results."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import TypeAlias

from analysis.claims.sources import RootSource, Source
from analysis.data.frames import Frames
from analysis.formatting import interval_text, number, p_value
from analysis.names import label
from analysis.statistics import Comparison
from analysis.statistics.samples import Standing, contrary, equivalent, greater
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
from tma_ray.support.texts import counted
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Finding:
    """Result of testing a statement of a claim.

    Attributes:
        standing: supported, refuted or undecided, by an interval against a margin.
        evidence: numbers of the test, or the reason why they are missing.
    """

    standing: Standing
    evidence: str


@dataclass(frozen=True)
class ClaimVerdict:
    """Verdict on a claim, from the tests of its statements.

    Attributes:
        claim: claim of the paper.
        standing: standing of the claim.
        findings: results of its statements; statements on the same runs share one.
        needed: number of findings that must be supported.
        conditions: conditions in which the results differ from the paper's; empty if there are none.
    """

    claim: Claim
    standing: Standing
    findings: tuple[Finding, ...]
    needed: int
    conditions: str = ""

    @property
    def standing_text(self) -> str:
        """Verdict as a phrase, with the conditions of the results if it is "not seen here"."""
        return f"{self.standing} ({self.conditions})" if self.standing is Standing.NOT_SEEN else self.standing

    def describe(self) -> str:
        """Return a phrase with the numbers of statements supported, refuted or undecided."""
        counts = Counter(finding.standing for finding in self.findings)
        parts = [f"{counts[Standing.SUPPORTED]} of {len(self.findings)} statements supported"]
        parts += [f"{counts[s]} {s}" for s in Standing if s is not Standing.SUPPORTED and counts[s]]
        if self.needed < len(self.findings):
            parts.append(f"{self.needed} {self.claim.threshold}")
        if len(self.findings) < len(self.claim.statements):
            parts.append(
                f"of {len(self.claim.statements)} in the paper, some of which are the same runs here"
            )
        return ", ".join(parts + ([self.claim.caveat] if self.claim.caveat else []))


def judge(source: Source, claims: Sequence[Claim] = CLAIMS) -> list[ClaimVerdict]:
    """Return the verdict on each claim, tested against the results of `source`.

    Statements on the same runs, as at levels that a teacher does not use, count as one, with `needed` scaled
    down. Under other conditions than the paper's, `NOT_SEEN` replaces `REFUTED`.
    """
    verdicts = []
    for claim in claims:
        distinct = _distinct(claim, source)
        conditions = source.other_conditions(_readings(claim.statements[0])[0])
        findings = tuple(_finding(statement, source, levels) for statement, levels in distinct)
        if conditions:
            findings = tuple(
                replace(finding, standing=Standing.NOT_SEEN)
                if finding.standing is Standing.REFUTED
                else finding
                for finding in findings
            )
        needed = math.ceil(claim.needed * len(findings) / len(claim.statements))
        counts = Counter(finding.standing for finding in findings)
        unknown = counts[Standing.UNDECIDED] + counts[Standing.NO_DATA]
        standing = Standing.NO_DATA if counts[Standing.NO_DATA] == len(findings) else Standing.UNDECIDED
        if counts[Standing.SUPPORTED] >= needed:
            standing = Standing.SUPPORTED
        elif counts[Standing.SUPPORTED] + unknown < needed:
            standing = Standing.NOT_SEEN if conditions else Standing.REFUTED
        verdicts.append(ClaimVerdict(claim, standing, findings, needed, conditions))
    return verdicts


Levels: TypeAlias = Mapping[Reading, tuple[KnowledgeLevel, ...]]
"""Levels of expert knowledge at which a reading has the same runs."""


def _distinct(claim: Claim, source: Source) -> list[tuple[Statement, Levels]]:
    """Return a claim's statements with the levels of their readings, merging statements on the same runs."""
    groups: dict[object, list[Statement]] = {}
    for index, statement in enumerate(claim.statements):
        samples = [source.sample(reading) for reading in _readings(statement)]
        runs = tuple(sample.runs if sample else frozenset() for sample in samples)
        key: object = index
        if all(runs) and not isinstance(statement, Ranked):  # a rank depends on other teachers' runs, too
            content = (
                replace(value, level=KnowledgeLevel.NONE) if isinstance(value, Reading) else value
                for value in vars(statement).values()
            )
            key = runs, type(statement), *content
        groups.setdefault(key, []).append(statement)
    return [
        (
            statements[0],
            {
                readings[0]: tuple(dict.fromkeys(reading.level for reading in readings))
                for readings in zip(*map(_readings, statements), strict=True)
            },
        )
        for statements in groups.values()
    ]


def _readings(statement: Statement) -> tuple[Reading, ...]:
    """Return the readings of a statement, each the results of a teacher on a challenge."""
    return tuple(value for value in vars(statement).values() if isinstance(value, Reading))


@singledispatch
def _finding(statement: Statement, source: Source, levels: Levels) -> Finding:
    raise NotImplementedError(f"statements of type {type(statement).__name__}")


@_finding.register
def _(statement: Compared, source: Source, levels: Levels) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    test = first.test(second)
    interval = test.reason or f"95 % interval {interval_text(test.low, test.high)}, {p_value(test.p)}"
    evidence = (
        f"{_name(statement.first, levels)} {number(test.difference)} points from "
        f"{_name(statement.second, levels)} ({interval}, n = {test.n} and {test.reference_n})"
    )
    return Finding(_relation(statement.relation, test), evidence)


@_finding.register
def _(statement: Bounded, source: Source, levels: Levels) -> Finding:
    sample, name = source.sample(statement.reading), _name(statement.reading, levels)
    if sample is None or (statement.best_seed and math.isnan(sample.best)):
        return _missing(statement.reading)
    if statement.best_seed:
        holds = statement.least <= sample.best <= statement.most
        evidence = f"{name}: best seed {number(sample.best)} %, n = {sample.description.n}"
        return Finding(Standing.SUPPORTED if holds else Standing.REFUTED, evidence)
    low, high = sample.interval()
    standing = Standing.UNDECIDED
    if statement.least <= low and high <= statement.most:
        standing = Standing.SUPPORTED
    elif low > statement.most or high < statement.least:
        standing = Standing.REFUTED
    mean = f"mean {number(sample.description.mean)} % [{number(low)}, {number(high)}]"
    return Finding(standing, f"{name}: {mean}, n = {sample.description.n}")


@_finding.register
def _(statement: Ranked, source: Source, levels: Levels) -> Finding:
    samples = {
        teacher: source.sample(replace(statement.reading, teacher=teacher))
        for teacher in source.teachers(statement.reading)
        if teacher in TEACHERS
    }
    others = {teacher: sample for teacher, sample in samples.items() if sample is not None}
    sample = others.pop(statement.reading.teacher, None)
    if sample is None:
        return _missing(statement.reading)
    if len(others) < statement.top:
        evidence = (
            f"{_name(statement.reading, levels)}: complete results of "
            f"{counted(len(others), 'other teacher')} of the paper, too few for a place among the "
            f"best {statement.top}"
        )
        return Finding(Standing.NO_DATA, evidence)
    ahead = Counter(_relation(Relation.BETTER, other.test(sample)) for other in others.values())
    standing = Standing.UNDECIDED
    if ahead[Standing.SUPPORTED] >= statement.top:
        standing = Standing.REFUTED
    elif ahead[Standing.SUPPORTED] + ahead[Standing.UNDECIDED] < statement.top:
        standing = Standing.SUPPORTED
    rank = 1 + sum(other.description.mean > sample.description.mean for other in others.values())
    evidence = (
        f"{_name(statement.reading, levels)}: place {rank} of {len(others) + 1} by mean; "
        f"{ahead[Standing.SUPPORTED]} better, {ahead[Standing.UNDECIDED]} undecided"
    )
    return Finding(standing, evidence)


@_finding.register
def _(statement: Scaled, source: Source, levels: Levels) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    factor, test = statement.factor, first.test(second.times(statement.factor))
    evidence = (
        f"{_name(statement.first, levels)}: {number(first.description.mean)} % and "
        f"{number(second.description.mean)} %; first less {factor:g} times second {number(test.difference)} "
        f"{interval_text(test.low, test.high)}"
    )
    return Finding(greater(test.low, test.high, 0.0), evidence)


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
    return Finding(Standing.NO_DATA, f"{_name(reading, {})}: no complete results")


def _name(reading: Reading, levels: Levels) -> str:
    names = [reading.environment] * (reading.environment != "stump_tracks")
    names += [reading.challenge] * (reading.challenge != "original" or not names)
    body = f", {reading.embodiment}" if reading.embodiment else ""
    share = f", after {reading.share:.0%}" if reading.share < 1 else ""
    level = " and ".join(levels.get(reading, (reading.level,)))
    return f"{label(reading.teacher)} ({' '.join(names).replace('_', ' ')}, {level}{body}{share})"


def decided(verdicts: Sequence[ClaimVerdict]) -> list[ClaimVerdict]:
    """Return the verdicts other than `NO_DATA`."""
    return [verdict for verdict in verdicts if verdict.standing is not Standing.NO_DATA]


def root_verdicts(frames: Frames) -> tuple[list[ClaimVerdict], list[str]]:
    """Return the verdicts on the paper's claims, based on a root's results, and notes on the results used."""
    source = RootSource(frames)
    return judge(source), [source.note] if source.note else []
