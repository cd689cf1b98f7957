"""Whether results bear out what the paper claims of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import singledispatch
from typing import Protocol

import pandas as pd

from analysis.formatting import number, p_value
from analysis.statistics import SIGNIFICANCE, Comparison, Description, welch, welch_from_statistics
from analysis.style import label
from tma_ray.benchmark.claims import CLAIMS
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


class Standing(StrEnum):
    """What results say of a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    OPEN = "not enough data"


@dataclass(frozen=True)
class Sample:
    """What is known of one reading.

    Attributes:
        description: n, mean and std of mastered tasks, in per cent.
        values: one per run, by run id; None where only the description is known.
    """

    description: Description
    values: pd.Series | None = None


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
        standing: whether it holds.
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
        standing: whether it holds.
        findings: of each of its statements.
    """

    claim: Claim
    standing: Standing
    findings: tuple[Finding, ...]

    def describe(self) -> str:
        """Returns how many of the statements hold, in words."""
        counts = {s: sum(finding.standing is s for finding in self.findings) for s in Standing}
        text = f"{counts[Standing.HOLDS]} of {len(self.findings)} hold"
        if self.claim.needed < len(self.findings):
            text += f", {self.claim.needed} are claimed"
        return text + (f", {counts[Standing.OPEN]} are open" if counts[Standing.OPEN] else "")


def judge(source: Source, claims: Sequence[Claim] = CLAIMS) -> list[Verdict]:
    """Returns what `source` says of each of `claims`."""
    return [_judge(source, claim) for claim in claims]


def _judge(source: Source, claim: Claim) -> Verdict:
    findings = tuple(_finding(statement, source) for statement in claim.statements)
    held = sum(finding.standing is Standing.HOLDS for finding in findings)
    undecided = sum(finding.standing is Standing.OPEN for finding in findings)
    standing = Standing.OPEN
    if held >= claim.needed:
        standing = Standing.HOLDS
    elif held + undecided < claim.needed:
        standing = Standing.FAILS
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
    return Finding(statement, _relation_holds(statement.relation, test), _evidence(statement, test))


@_finding.register
def _(statement: Bounded, source: Source) -> Finding:
    sample = source.sample(statement.reading)
    if sample is None or (statement.best_seed and sample.values is None):
        return _missing(statement, statement.reading)
    value = sample.description.mean
    if statement.best_seed and sample.values is not None:
        value = float(sample.values.max())
    what = "best seed" if statement.best_seed else "mean"
    evidence = f"{_name(statement.reading)}: {what} {number(value)} %, n = {sample.description.n}"
    return Finding(statement, _standing(statement.least <= value <= statement.most), evidence)


@_finding.register
def _(statement: Ranked, source: Source) -> Finding:
    samples = {
        teacher: source.sample(_of(teacher, statement.reading))
        for teacher in source.teachers(statement.reading)
    }
    means = {teacher: sample.description.mean for teacher, sample in samples.items() if sample is not None}
    if statement.reading.teacher not in means or len(means) <= statement.top:
        return _missing(statement, statement.reading)
    ranked = sorted(means, key=lambda teacher: -means[teacher])
    place = ranked.index(statement.reading.teacher) + 1
    order = ", ".join(f"{label(teacher)} {number(means[teacher])}" for teacher in ranked[:4])
    evidence = f"{_name(statement.reading)}: place {place} of {len(ranked)} ({order})"
    return Finding(statement, _standing(place <= statement.top), evidence)


@_finding.register
def _(statement: Scaled, source: Source) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement, statement.first if first is None else statement.second)
    mine, theirs = first.description.mean, second.description.mean
    evidence = f"{_name(statement.first)}: {number(mine)} % beside {number(theirs)} %"
    return Finding(statement, _standing(mine >= statement.factor * theirs), evidence)


def _test(first: Sample, second: Sample) -> Comparison:
    if first.values is not None and second.values is not None:
        return welch(first.values, second.values)
    return welch_from_statistics(first.description, second.description)


def _relation_holds(relation: Relation, test: Comparison) -> Standing:
    if relation is Relation.LOWER:
        return _standing(test.difference < 0) if math.isfinite(test.difference) else Standing.OPEN
    if test.reason == "no spread between seeds":  # all seeds alike on both sides
        significant = test.difference != 0
    elif test.reason:
        return Standing.OPEN
    else:
        significant = test.p < SIGNIFICANCE
    better, worse = significant and test.difference > 0, significant and test.difference < 0
    holds = {
        Relation.BETTER: better,
        Relation.WORSE: worse,
        Relation.ALIKE: not significant,
        Relation.NOT_BETTER: not better,
    }
    return _standing(holds[relation])


def _evidence(statement: Compared, test: Comparison) -> str:
    beside = f"{_name(statement.first)} {number(test.difference)} points from {_name(statement.second)}"
    p = test.reason or p_value(test.p)
    return f"{beside} ({p}, n = {test.n} and {test.reference_n})"


def _missing(statement: Statement, reading: Reading) -> Finding:
    return Finding(statement, Standing.OPEN, f"{_name(reading)}: no complete results")


def _standing(holds: bool) -> Standing:
    return Standing.HOLDS if holds else Standing.FAILS


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
