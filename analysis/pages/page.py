"""Parts that pages share: templates, controls, the teachers shown first, the section over all challenges."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from analysis.charts.page import PageChart, on_page, plotly_library
from analysis.charts.profiles import FEWEST, profile_chart
from analysis.comparisons.boards import THRESHOLDS, overall_rows, performance_profiles
from analysis.comparisons.sentences import caveat
from analysis.data.reference import is_baseline
from analysis.formatting import amount
from analysis.looks import look
from analysis.measures.pooling import COMPARED
from analysis.measures.tested import HEADLINE, QUANTITIES
from analysis.names import challenge_title, marked_label, teacher_order
from tma_ray.commands.texts import visible


def page(template: str, **content: Any) -> str:
    """Return the page that `template`, of the folder of templates, makes of `content`."""
    return _environment().get_template(template).render(**content)


@cache
def _environment() -> Environment:
    """Return the environment of templates, which compiles each once."""
    environment = Environment(
        loader=PackageLoader("analysis.pages.page"),
        autoescape=True,
        finalize=lambda value: visible(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.globals["plotly_library"] = plotly_library
    return environment


def page_folder(root: str | Path, output: Path | None, name: str, what: str) -> Path:
    """Return the folder that a page about `root` is written to: `output`, or `name` in `root`.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        output: folder that the user asked for, if any.
        name: name of the folder.
        what: kind of page, for messages.

    Raises:
        ValueError: no `output`, and an object store or a root in which links would be written through.
    """
    if output is not None:
        return output
    if "://" in str(root):
        raise ValueError(f"{root} is not a local folder: say in which folder to write the {what}")
    folder = Path(root) / name
    for path in chain([folder], folder.rglob("*")):
        if path.is_symlink():
            raise ValueError(
                f"{path} is a symbolic link, which may lead out of the root: remove it, or say in which "
                f"folder to write the {what}"
            )
    return folder


def write_page(folder: Path, text: str, beside: Mapping[str, bytes]) -> Path:
    """Write a page as ``index.html`` of a folder, with other files by name; return the page."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in beside.items():
        (folder / name).write_bytes(content)
    index = folder / "index.html"
    index.write_text(text, encoding="utf-8")
    return index


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


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
    """An option of a control: value in the data, name, colour, and True if it is shown at first."""

    value: str
    name: str
    colour: str = ""
    shown: bool = True


@dataclass(frozen=True)
class Filter:
    """A column by which comparisons may be chosen, with its values."""

    column: str
    name: str
    choices: tuple[Choice, ...]


@dataclass(frozen=True)
class Controls:
    """Controls of a page.

    Attributes:
        teachers: teachers that may be left out.
        filters: filters with more than one choice each.
        steps: steps of evaluations, ascending.
    """

    teachers: tuple[Choice, ...]
    filters: tuple[Filter, ...]
    steps: tuple[Choice, ...]

    @property
    def hidden(self) -> int:
        """Number of teachers that the page does not show at first."""
        return sum(not teacher.shown for teacher in self.teachers)

    @property
    def any(self) -> bool:
        """True if there is anything to choose."""
        return len(self.teachers) > 1 or bool(self.filters) or len(self.steps) > 1


def controls(
    comparisons: pd.DataFrame, teachers: Iterable[str], steps: Iterable[int], shown: Collection[str]
) -> Controls:
    """Return the controls of a page.

    Args:
        comparisons: one row each, with some of the columns of `FILTERS`.
        teachers: teachers of the page.
        steps: steps at which students were evaluated.
        shown: teachers that are shown at first.
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
    """True if experiments are the challenges by other names."""
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


MANY = 12
"""Up to so many teachers are all shown at first."""

SHOWN = 8
"""Of more teachers so many are shown at first, beside Random."""


def leading(
    results: pd.DataFrame, measure: str, teachers: Iterable[object], within: Sequence[str] = ()
) -> frozenset[str]:
    """Return the teachers that a page shows at first: all, or of many Random and the best.

    The best are those with the highest mean of a measure over the challenges that each has results of, and
    the best one of each comparison that would otherwise be empty.

    Args:
        results: a row for each teacher and challenge, with the columns teacher and `measure`.
        measure: column of `results`; NaN where there is nothing.
        teachers: all teachers of the page, also those without results yet.
        within: columns that the teachers of a comparison have in common.
    """
    everyone = frozenset(map(str, teachers))
    if len(everyone) <= MANY:
        return everyone
    means = results.groupby("teacher")[measure].mean().sort_values(ascending=False, kind="stable")
    others = [str(teacher) for teacher in means.index if not is_baseline(str(teacher))]
    shown = {*others[:SHOWN], *(str(each) for each in means.index if is_baseline(str(each)))}
    if within:
        best = results.dropna(subset=[measure]).sort_values(measure, ascending=False, kind="stable")
        for _, rows in best.groupby(list(within), dropna=False, sort=True):
            if shown.isdisjoint(rows["teacher"]):
                shown.add(str(rows["teacher"].iloc[0]))
    return frozenset(shown)


CAPTION = (
    "Share of runs that master more of the test tasks than the horizontal axis says; bands are exact 95 % "
    f"intervals, threshold by threshold, of {FEWEST} runs and more; all challenges together."
)


@dataclass(frozen=True, eq=False)
class Overall:
    """Content of the section over all challenges.

    Attributes:
        rows: rows of `overall_rows`.
        over: thresholds of the last column, as text.
        charts: performance profiles, one for each level and budget.
        quantity: name of the aggregated measure.
        caveat: warning where a teacher has few runs of a challenge; else empty.
    """

    rows: list[dict[str, Any]]
    over: str
    charts: list[PageChart]
    quantity: str
    caveat: str


def overall_section(runs: pd.DataFrame, measure: str = HEADLINE) -> Overall:
    """Return the section on all runs that count as results, of `pooling.pool_runs`."""
    over = " / ".join(map(str, THRESHOLDS))
    return Overall(
        overall_rows(runs, measure),
        over,
        list(_charts(runs, measure)),
        QUANTITIES[measure],
        _caveat(runs, measure),
    )


def _caveat(runs: pd.DataFrame, measure: str) -> str:
    counted = runs[runs[measure].notna()]
    return caveat(counted.groupby([*COMPARED, "teacher"], dropna=False)["run_id"].nunique().min())


def _charts(runs: pd.DataFrame, measure: str) -> Iterator[PageChart]:
    for count, (where, table) in enumerate(performance_profiles(runs, measure), start=1):
        title = f"Performance profiles, {where}"
        yield on_page(profile_chart(table, QUANTITIES[measure], f"profiles-{count}", title, CAPTION))
