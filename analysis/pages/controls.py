"""Controls of a page: teachers, the step, and comparisons."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import pandas as pd

from analysis.formatting import amount
from analysis.looks import look
from analysis.names import challenge_title, marked_label, teacher_order

FILTERS = {
    "engine": "Engine",
    "experiment": "Experiment",
    "environment": "Environment",
    "challenge": "Challenge",
    "expert_knowledge": "Expert knowledge",
    "embodiment": "Body",
    "student": "Student",
}
"""Columns by which comparisons may be chosen, and what readers call them."""


@dataclass(frozen=True)
class Choice:
    """One of several: its value in the data, its name, and whether a page shows it at first."""

    value: str
    name: str
    colour: str = ""
    shown: bool = True


@dataclass(frozen=True)
class Filter:
    """A column by which comparisons may be chosen, and what there is of it."""

    column: str
    name: str
    choices: tuple[Choice, ...]


@dataclass(frozen=True)
class Controls:
    """What a reader may choose.

    Attributes:
        teachers: that may be left out.
        filters: with more than one choice each.
        steps: of evaluations, ascending, as value and name.
    """

    teachers: tuple[Choice, ...]
    filters: tuple[Filter, ...]
    steps: tuple[Choice, ...]

    @property
    def hidden(self) -> int:
        """How many teachers the page does not show at first."""
        return sum(not teacher.shown for teacher in self.teachers)

    @property
    def any(self) -> bool:
        """Whether there is anything to choose."""
        return len(self.teachers) > 1 or bool(self.filters) or len(self.steps) > 1


def controls(
    comparisons: pd.DataFrame, teachers: Iterable[str], steps: Iterable[int], shown: Collection[str]
) -> Controls:
    """Returns what a reader may choose.

    Args:
        comparisons: one row each, with some of the columns of `FILTERS`.
        teachers: that the page has.
        steps: at which students were evaluated.
        shown: teachers that it shows at first.
    """
    named = tuple(
        Choice(teacher, marked_label(teacher), look(teacher).colour, teacher in shown)
        for teacher in sorted(set(map(str, teachers)), key=teacher_order)
    )
    filters = [_filter(comparisons, column) for column in FILTERS if column in comparisons]
    return Controls(
        teachers=named,
        filters=tuple(each for each in filters if len(each.choices) > 1 and not _repeats(comparisons, each)),
        steps=tuple(Choice(str(step), f"{amount(step)} steps") for step in sorted(set(map(int, steps)))),
    )


def _repeats(comparisons: pd.DataFrame, found: Filter) -> bool:
    """Tells whether experiments are just the challenges by other names."""
    return found.column == "experiment" and bool(
        (comparisons["experiment"] == comparisons["challenge"]).all()
    )


def _filter(comparisons: pd.DataFrame, column: str) -> Filter:
    values = list(dict.fromkeys(map(str, comparisons[column])))
    environments = list(comparisons["environment"]) if "environment" in comparisons else []
    choices = [Choice(value, _name(column, value, environments)) for value in values]
    return Filter(column, FILTERS[column], tuple(choices))


def _name(column: str, value: str, environments: Sequence[str]) -> str:
    if column == "challenge":
        for environment in dict.fromkeys(environments):
            if title := challenge_title(environment, value, ""):
                return title
    if column == "engine":
        return value
    if column == "student":
        return value.upper()
    words = value.replace("_", " ") if value else "none"
    return words[:1].upper() + words[1:] if column != "experiment" else words
