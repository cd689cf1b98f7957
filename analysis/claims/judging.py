"""Claims of the paper, held against results."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import TypeAlias

from analysis.claims.sources import RootSource, Source
from analysis.data.frames import Frames
from analysis.formatting import ends, number, p_value
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
        findings: one for each of its statements, those of the same runs once.
        needed: number of the findings that must hold.
        elsewhere: conditions of the results if they are not the paper's, in words; else empty.
    """

    claim: Claim
    standing: Standing
    findings: tuple[Finding, ...]
    needed: int
    elsewhere: str = ""

    @property
    def said(self) -> str:
        """The standing in words, with the conditions under which a claim was not seen."""
        return f"{self.standing} ({self.elsewhere})" if self.standing is Standing.NOT_SEEN else self.standing

    def describe(self) -> str:
        """Return the number of statements of each standing, in words."""
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


def judge(source: Source, claims: Sequence[Claim] = CLAIMS) -> list[Verdict]:
    """Return the standing of each of `claims` by the results of `source`.

    Statements that come to the same runs, as at levels that a teacher does not use, are one, and as many as
    their share of the paper's must hold. What the paper's conditions would refute is not seen under others.
    """
    found = []
    for claim in claims:
        distinct = _distinct(claim, source)
        elsewhere = source.elsewhere(_readings(claim.statements[0])[0])
        findings = tuple(_finding(statement, source, levels) for statement, levels in distinct)
        if elsewhere:
            findings = tuple(
                replace(each, standing=Standing.NOT_SEEN) if each.standing is Standing.REFUTED else each
                for each in findings
            )
        needed = math.ceil(claim.needed * len(findings) / len(claim.statements))
        counts = Counter(finding.standing for finding in findings)
        unknown = counts[Standing.UNDECIDED] + counts[Standing.NO_DATA]
        standing = Standing.NO_DATA if counts[Standing.NO_DATA] == len(findings) else Standing.UNDECIDED
        if counts[Standing.SUPPORTED] >= needed:
            standing = Standing.SUPPORTED
        elif counts[Standing.SUPPORTED] + unknown < needed:
            standing = Standing.NOT_SEEN if elsewhere else Standing.REFUTED
        found.append(Verdict(claim, standing, findings, needed, elsewhere))
    return found


Levels: TypeAlias = Mapping[Reading, tuple[KnowledgeLevel, ...]]
"""Levels at which a reading is of the same runs, of readings with several."""


def _distinct(claim: Claim, source: Source) -> list[tuple[Statement, Levels]]:
    """Return the statements of a claim, those of the same runs once, and the levels of their readings."""
    alike: dict[object, list[Statement]] = {}
    for place, statement in enumerate(claim.statements):
        samples = [source.sample(reading) for reading in _readings(statement)]
        runs = tuple(sample.runs if sample else frozenset() for sample in samples)
        same: object = place
        if all(runs) and not isinstance(statement, Ranked):  # a rank is among others, too
            same = runs, _at_no_level(statement)
        alike.setdefault(same, []).append(statement)
    found: list[tuple[Statement, Levels]] = []
    for statements in alike.values():
        readings = zip(*map(_readings, statements), strict=True)
        levels = {each[0]: tuple(dict.fromkeys(reading.level for reading in each)) for each in readings}
        found.append((statements[0], levels))
    return found


def _readings(statement: Statement) -> tuple[Reading, ...]:
    """Return the readings of a statement."""
    return tuple(value for value in vars(statement).values() if isinstance(value, Reading))


def _at_no_level(statement: Statement) -> tuple[object, ...]:
    """Return the content of a statement without the level of its readings."""
    said = (
        replace(value, level=KnowledgeLevel.NONE) if isinstance(value, Reading) else value
        for value in vars(statement).values()
    )
    return (type(statement), *said)


@singledispatch
def _finding(statement: Statement, source: Source, levels: Levels) -> Finding:
    raise NotImplementedError(f"statements of type {type(statement).__name__}")


@_finding.register
def _(statement: Compared, source: Source, levels: Levels) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    test = first.test(second)
    names = " ".join(
        [
            _name(statement.first, levels),
            f"{number(test.difference)} points from",
            _name(statement.second, levels),
        ]
    )
    interval = test.reason or f"95 % interval {ends(test.low, test.high)}, {p_value(test.p)}"
    evidence = f"{names} ({interval}, n = {test.n} and {test.reference_n})"
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
    known = {teacher: sample for teacher, sample in samples.items() if sample is not None}
    mine = known.pop(statement.reading.teacher, None)
    if mine is None:
        return _missing(statement.reading)
    if len(known) < statement.top:
        others = counted(len(known), "other teacher")
        evidence = (
            f"{_name(statement.reading, levels)}: complete results of {others} of the paper, too few for a "
            f"place among the best {statement.top}"
        )
        return Finding(Standing.NO_DATA, evidence)
    ahead = Counter(_relation(Relation.BETTER, other.test(mine)) for other in known.values())
    standing = Standing.UNDECIDED
    if ahead[Standing.SUPPORTED] >= statement.top:
        standing = Standing.REFUTED
    elif ahead[Standing.SUPPORTED] + ahead[Standing.UNDECIDED] < statement.top:
        standing = Standing.SUPPORTED
    place = 1 + sum(other.description.mean > mine.description.mean for other in known.values())
    evidence = (
        f"{_name(statement.reading, levels)}: place {place} of {len(known) + 1} by mean; better are "
        f"{ahead[Standing.SUPPORTED]} for certain, {ahead[Standing.UNDECIDED]} perhaps"
    )
    return Finding(standing, evidence)


@_finding.register
def _(statement: Scaled, source: Source, levels: Levels) -> Finding:
    first, second = source.sample(statement.first), source.sample(statement.second)
    if first is None or second is None:
        return _missing(statement.first if first is None else statement.second)
    mine, theirs, factor = first.description, second.description, statement.factor
    test = first.test(second.times(factor))
    evidence = (
        f"{_name(statement.first, levels)}: {number(mine.mean)} % and {number(theirs.mean)} %; above "
        f"{factor:g} times that by {number(test.difference)} {ends(test.low, test.high)}"
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
    place = [reading.environment] * (reading.environment != "stump_tracks")
    place += [reading.challenge] * (reading.challenge != "original" or not place)
    body = f", {reading.embodiment}" if reading.embodiment else ""
    share = f", after {reading.share:.0%}" if reading.share < 1 else ""
    level = " and ".join(levels.get(reading, (reading.level,)))
    return f"{label(reading.teacher)} ({' '.join(place).replace('_', ' ')}, {level}{body}{share})"


def decided(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return the `verdicts` on which the results decide at least one statement."""
    return [verdict for verdict in verdicts if verdict.standing is not Standing.NO_DATA]


def root_verdicts(frames: Frames) -> tuple[list[Verdict], list[str]]:
    """Return the standing of each of the paper's claims by the results of a root, and notes.

    These say which of the results claims are judged by, where there are several kinds.
    """
    source = RootSource(frames)
    return judge(source), [source.note] if source.note else []
