"""Statements about results, in a form that can be checked."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Reading:
    """Mastered tasks of one teacher on one challenge, over all bodies and students unless told otherwise.

    Attributes:
        teacher: name in the teacher registry.
        challenge: name of a challenge.
        level: of expert knowledge.
        environment: name in the environment registry.
        embodiment: the one body that is looked at; empty for all.
        share: of the training budget, after which it is read.
    """

    teacher: str
    challenge: str
    level: KnowledgeLevel
    environment: str = "stump_tracks"
    embodiment: str = ""
    share: float = 1.0


class Relation(StrEnum):
    """Relation of one reading to another, by the 95 % interval of their difference and a margin.

    Attributes:
        BETTER: over the other.
        WORSE: under the other.
        ALIKE: not different by the margin or more.
        NOT_BETTER: not over the other by the margin or more.
        LOWER: under the other on average, however little.
    """

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "not different"
    NOT_BETTER = "not better"
    LOWER = "lower on average"


@dataclass(frozen=True)
class Compared:
    """The first reading is in `relation` to the second."""

    first: Reading
    relation: Relation
    second: Reading


@dataclass(frozen=True)
class Bounded:
    """The mean of the reading is at most `most`, or at least `least`, in per cent of the test tasks.

    With `best_seed` it is the best seed and not the mean.
    """

    reading: Reading
    most: float = 100.0
    least: float = 0.0
    best_seed: bool = False


@dataclass(frozen=True)
class Ranked:
    """The mean of the reading is among the `top` highest of the paper's teachers there."""

    reading: Reading
    top: int


@dataclass(frozen=True)
class Scaled:
    """The mean of the first reading is at least `factor` times that of the second."""

    first: Reading
    factor: float
    second: Reading


Statement = Compared | Bounded | Ranked | Scaled


@dataclass(frozen=True)
class Claim:
    """A sentence about results, and the statements it consists of.

    Attributes:
        name: short, for tables and links.
        text: the claim in our words.
        source: where the paper makes it.
        statements: what it says of single results.
        at_least: how many of the statements must hold; None for all.
        ours: whether `at_least` is our reading of a sentence without a number.
        caveat: doubts about the results that the paper's sentence rests on.
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
        """Number of the statements that must hold."""
        return len(self.statements) if self.at_least is None else self.at_least

    @property
    def threshold(self) -> str:
        """Words for who says how many of the statements must hold."""
        return "needed by our reading" if self.ours else "claimed"
