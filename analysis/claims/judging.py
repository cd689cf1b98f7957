"""Claims of the paper held against results: each is supported, refuted or undecided."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Protocol

import pandas as pd

from analysis.formatting import ends, number, p_value
from analysis.measures.shared_students import Seeds, compared
from analysis.names import label
from analysis.statistics import (
    Comparison,
    Description,
    mean_percent_interval,
    welch_from_statistics,
)
from analysis.statistics.verdicts import Standing, contrary, equivalent, greater
from tma_ray.benchmark.claims import CLAIMS
from tma_ray.benchmark.experiments import TEACHERS
from tma_ray.benchmark.statements import (
    Bounded,
    Claim,
    Compared,
    Ranked,
    Reading,
    Relation,
    Scaled,
    Statement,
)


@dataclass(frozen=True)
class Sample:
    """What is known of one reading.

    Attributes:
        description: n, mean and std of mastered tasks, in per cent.
        values: one per run, by run id; None where only the description is known.
        seeds: of the runs that are to be paired by them.
    """

    description: Description
    values: pd.Series | None = None
    seeds: Seeds = field(default_factory=dict)


class Source(Protocol):
    """Results that readings can be looked up in."""

    def sample(self, reading: Reading) -> Sample | None:
        """Returns what is known of `reading`; None if it is not there, or not all of it."""

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Returns who has results where `reading` is read."""


@dataclass(frozen=True)
class Finding:
    """A statement held against results.

    Attributes:
        statement: what was claimed.
        standing: by an interval against a margin.
        evidence: the numbers behind that, or what is missing.
    """

    statement: Statement
    standing: Standing
    evidence: str


@dataclass(frozen=True)
class Verdict:
    """A claim held against results.

    Attributes:
        claim: what was claimed.
        standing: by an interval against a margin.
        findings: of each of its statements.
    """

    claim: Claim
    standing: Standing
    findings: tuple[Finding, ...]

    def describe(self) -> str:
        """Returns the number of statements of each standing, in words."""
        counts = {s: sum(finding.standing is s for finding in self.findings) for s in Standing}
        parts = [f"{counts[Standing.SUPPORTED]} of {len(self.findings)} statements supported"]
        parts += [f"{counts[s]} {s}" for s in Standing if s is not Standing.SUPPORTED and counts[s]]
        if self.claim.needed < len(self.findings):
            parts.append(f"{self.claim.needed} {self.claim.threshold}")
        return ", ".join(parts + ([self.claim.caveat] if self.claim.caveat else []))


def judge(source: Source, claims: Sequence[Claim] = CLAIMS) -> list[Verdict]:
    """Returns what `source` says of each of `claims`."""
    return [_judge(source, claim) for claim in claims]


def _judge(source: Source, claim: Claim) -> Verdict:
    findings = tuple(_finding(statement, source) for statement in claim.statements)
    counts = Counter(finding.standing for finding in findings)
    unknown = counts[Standing.UNDECIDED] + counts[Standing.NO_DATA]
    standing = Standing.NO_DATA if counts[Standing.NO_DATA] == len(findings) else Standing.UNDECIDED
    if counts[Standing.SUPPORTED] >= claim.needed:
        standing = Standing.SUPPORTED
    elif counts[Standing.SUPPORTED] + unknown < claim.needed:
        standing = Standing.REFUTED
    return Verdict(claim, standing, findings)


@singledispatch
def _finding(statement: Statement, source: Source) -> Finding:
    raise NotImplementedError(f"statements of type {type(statement).__name__}")


@_finding.register
def _(statement: Compared, source: Source) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement, statement.first if first is None else statement.second)
    test = _test(first, second)
    return Finding(statement, _relation(statement.relation, test), _evidence(statement, test))


@_finding.register
def _(statement: Bounded, source: Source) -> Finding:
    sample = source.sample(statement.reading)
    if sample is None or (statement.best_seed and sample.values is None):
        return _missing(statement, statement.reading)
    if statement.best_seed and sample.values is not None:
        best = float(sample.values.max())
        evidence = f"{_name(statement.reading)}: best seed {number(best)} %, n = {sample.description.n}"
        return Finding(statement, _certain(statement.least <= best <= statement.most), evidence)
    low, high = mean_percent_interval(sample.description)
    standing = Standing.UNDECIDED
    if statement.least <= low and high <= statement.most:
        standing = Standing.SUPPORTED
    elif low > statement.most or high < statement.least:
        standing = Standing.REFUTED
    mean = f"mean {number(sample.description.mean)} % [{number(low)}, {number(high)}]"
    return Finding(statement, standing, f"{_name(statement.reading)}: {mean}, n = {sample.description.n}")


@_finding.register
def _(statement: Ranked, source: Source) -> Finding:
    samples = {
        teacher: source.sample(_of(teacher, statement.reading))
        for teacher in source.teachers(statement.reading)
        if teacher in TEACHERS
    }
    known = {teacher: sample for teacher, sample in samples.items() if sample is not None}
    mine = known.pop(statement.reading.teacher, None)
    if mine is None or len(known) < statement.top:
        return _missing(statement, statement.reading)
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
    return Finding(statement, standing, evidence)


@_finding.register
def _(statement: Scaled, source: Source) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement, statement.first if first is None else statement.second)
    scaled = Description(
        second.description.n,
        statement.factor * second.description.mean,
        statement.factor * second.description.std,
    )
    test = welch_from_statistics(first.description, scaled)
    mine, theirs = first.description.mean, second.description.mean
    evidence = (
        f"{_name(statement.first)}: {number(mine)} % beside {number(theirs)} %; above {statement.factor:g} "
        f"times that by {number(test.difference)} {ends(test.low, test.high)}"
    )
    return Finding(statement, greater(test.low, test.high, 0.0), evidence)


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


def _evidence(statement: Compared, test: Comparison) -> str:
    beside = f"{_name(statement.first)} {number(test.difference)} points from {_name(statement.second)}"
    interval = test.reason or f"95 % interval {ends(test.low, test.high)}, {p_value(test.p)}"
    return f"{beside} ({interval}, n = {test.n} and {test.reference_n})"


def _missing(statement: Statement, reading: Reading) -> Finding:
    return Finding(statement, Standing.NO_DATA, f"{_name(reading)}: no complete results")


def _certain(holds: bool) -> Standing:
    return Standing.SUPPORTED if holds else Standing.REFUTED


def _of(teacher: str, reading: Reading) -> Reading:
    values = {name: getattr(reading, name) for name in ("challenge", "level", "environment", "embodiment")}
    return Reading(teacher, **values, share=reading.share)


def _place(reading: Reading) -> str:
    return reading.environment + ("" if reading.challenge == "original" else f" {reading.challenge}")


def _name(reading: Reading) -> str:
    place = reading.challenge if reading.environment == "stump_tracks" else _place(reading)
    body = f", {reading.embodiment}" if reading.embodiment else ""
    share = f", after {reading.share:.0%}" if reading.share < 1 else ""
    return f"{label(reading.teacher)} ({place.replace('_', ' ')}, {reading.level}{body}{share})"
