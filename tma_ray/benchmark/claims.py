"""Claims of the paper about its results, as data to test on any results."""

import itertools
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from tma_ray.benchmark.matrices import STUMP_TRACKS_CHALLENGES
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Reading:
    """Percentage of tasks mastered with one teacher on one challenge, pooled over bodies and students.

    Attributes:
        level: level of expert knowledge.
        embodiment: name of a single body, empty for all.
        share: share of the budget after which it is read.
    """

    teacher: str
    challenge: str
    level: KnowledgeLevel
    environment: str = "stump_tracks"
    embodiment: str = ""
    share: float = 1.0


class Relation(StrEnum):
    """Relation between two readings, judged by the 95 % interval of their difference and a margin.

    Attributes:
        BETTER: higher than the other.
        WORSE: lower than the other.
        ALIKE: not different by the margin or more.
        NOT_BETTER: not higher by the margin or more.
        LOWER: lower on average.
    """

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "not different"
    NOT_BETTER = "not better"
    LOWER = "lower on average"


@dataclass(frozen=True)
class Compared:
    """Statement about the relation between two readings."""

    first: Reading
    relation: Relation
    second: Reading


@dataclass(frozen=True)
class Bounded:
    """Statement that the mean of a reading, or its best seed, lies between two percentages."""

    reading: Reading
    most: float = 100.0
    least: float = 0.0
    best_seed: bool = False


@dataclass(frozen=True)
class Ranked:
    """Statement that the mean of a reading is among the `top` highest of the paper's teachers."""

    reading: Reading
    top: int


@dataclass(frozen=True)
class Scaled:
    """Statement that the mean of the first reading is at least `factor` times that of the second."""

    first: Reading
    factor: float
    second: Reading


Statement = Compared | Bounded | Ranked | Scaled


@dataclass(frozen=True)
class Claim:
    """Claim about results: a sentence, and statements that test it.

    Attributes:
        name: short name for tables and links.
        text: paraphrase of the claim.
        source: section of the paper.
        statements: statements about single results.
        at_least: number of statements that must hold, None for all.
        ours: True if `at_least` is our interpretation of a sentence without a number.
        caveat: doubts about the results behind the claim.
    """

    name: str
    text: str
    source: str
    statements: tuple[Statement, ...]
    at_least: int | None = None
    ours: bool = False
    caveat: str = ""

    @property
    def needed(self) -> int:
        """Number of statements that must hold."""
        return len(self.statements) if self.at_least is None else self.at_least

    @property
    def threshold(self) -> str:
        """Phrase that names the source of `needed`: the paper's claim or our reading of it."""
        return "needed by our reading" if self.ours else "claimed"


FIVE_CHALLENGES = tuple(matrix.challenge for matrix in STUMP_TRACKS_CHALLENGES)


def _statements(fields: Mapping[str, Any]) -> Iterator[Statement]:
    """Yield the statements of an entry in ``claims.toml``, whose first lines define the format."""
    lists = {name: value if isinstance(value, list) else [value] for name, value in fields.items()}
    challenges = {"challenge": lists.pop("challenge", FIVE_CHALLENGES)}
    for values in itertools.product(*(lists | challenges).values()):
        entry = dict(zip(lists | challenges, values, strict=True))
        of_readings = {name: entry.pop(name) for name in Reading.__annotations__ if name in entry}
        reading, other = _reading(of_readings), _reading(of_readings | entry.pop("than", {}))
        if "relation" in entry:
            yield Compared(reading, Relation(entry["relation"]), other)
        elif "factor" in entry:
            yield Scaled(reading, entry["factor"], other)
        elif "top" in entry:
            yield Ranked(reading, entry["top"])
        else:
            yield Bounded(reading, **entry)


def _reading(fields: Mapping[str, Any]) -> Reading:
    return Reading(**{**fields, "level": KnowledgeLevel(fields["level"])})


def _claims() -> Iterator[Claim]:
    text = (Path(__file__).parent / "claims.toml").read_text(encoding="utf-8")
    for fields in tomllib.loads(text)["claims"]:
        statements = itertools.chain.from_iterable(map(_statements, fields.pop("statements")))
        yield Claim(statements=tuple(statements), **fields)


CLAIMS: tuple[Claim, ...] = tuple(_claims())
"""Claims in section 5 and appendix D of the paper."""
