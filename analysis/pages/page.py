"""Parts that pages share: templates, controls, the teachers shown first, the section over all challenges."""

import base64
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from analysis.charts.page import on_page, packed, plotly_library
from analysis.charts.profiles import FEWEST, profile_chart
from analysis.comparisons.boards import THRESHOLDS, overall_rows, performance_profiles
from analysis.data.columns import COMPARED, FILTERS
from analysis.data.reference import is_baseline
from analysis.formatting import amount, caveat, plus_minus
from analysis.looks import look
from analysis.measures.tested import HEADLINE, QUANTITIES
from analysis.names import challenge_title, label, mark_of, marked_label, teacher_order
from analysis.statistics import SIGNIFICANCE
from tma_ray.console.exit_codes import installed_version
from tma_ray.support.texts import visible


def page(template: str, **content: Any) -> str:
    """Return the page rendered by `template`, from the folder of templates, with `content`."""
    version, written = installed_version("tma_ray"), datetime.now(UTC)
    found = _environment().get_template(template)
    return found.render(version=version, written=written, significance=SIGNIFICANCE, **content)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("analysis.pages.page"),
        autoescape=True,
        finalize=lambda value: visible(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {}  # keys stay in their order
    environment.filters["data_uri"] = lambda content, kind: (
        f"data:{kind};base64,{base64.b64encode(content).decode()}"
    )
    environment.filters["packed"] = lambda text: packed(str(text))
    environment.globals |= {"plotly_library": plotly_library, "plus_minus": plus_minus}
    environment.globals |= {"label": marked_label, "look": look, "mark_of": mark_of}
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


def controls(
    comparisons: pd.DataFrame, teachers: Iterable[str], steps: Iterable[int], shown: Collection[str]
) -> dict[str, Any] | None:
    """Return the controls of a page, None if there is nothing to choose.

    Args:
        comparisons: one row each, with some of the columns of `FILTERS`.
        teachers: teachers of the page.
        steps: steps at which students were evaluated.
        shown: teachers that are shown at first.

    Returns:
        Teachers that may be left out; columns that tell comparisons apart, with their names and their values,
        and the names of these; steps of evaluations, ascending, and their names.
    """
    named = [
        {"name": teacher, "shown": teacher in shown}
        for teacher in sorted(set(map(str, teachers)), key=teacher_order)
    ]
    filters = []
    for column, name in ((each, name) for each, name in FILTERS.items() if each in comparisons):
        values = list(dict.fromkeys(map(str, comparisons[column])))
        # Experiments may be the challenges by other names.
        repeated = column == "experiment" and bool((comparisons[column] == comparisons["challenge"]).all())
        if len(values) > 1 and not repeated:
            environments = comparisons["environment"].unique() if "environment" in comparisons else ()
            filters.append((column, name, [(value, _name(column, value, environments)) for value in values]))
    read_at = [(step, f"{amount(step)} steps") for step in sorted(set(map(int, steps)))]
    found = {"teachers": named, "filters": filters, "steps": read_at}
    return found if len(named) > 1 or filters or len(read_at) > 1 else None


def _name(column: str, value: str, environments: Iterable[str]) -> str:
    if column == "challenge":
        for environment in environments:
            if title := challenge_title(environment, value, ""):
                return title
    if column == "engine":
        return value
    if column == "student":
        return label(value)
    words = value.replace("_", " ") if value else "none"
    return words[:1].upper() + words[1:] if column != "experiment" else words


MANY = 12
"""Up to so many teachers are all shown at first."""

SHOWN = 8
"""Of more teachers so many are shown at first, beside Random."""


def leading(
    results: pd.DataFrame, measure: str, teachers: Iterable[object], within: Sequence[str] = ()
) -> frozenset[str]:
    """Return the teachers that a page shows initially: all, or Random and the best of many.

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


def overall_section(runs: pd.DataFrame, measure: str = HEADLINE) -> dict[str, Any]:
    """Return the content of the section over all challenges.

    Args:
        runs: all runs that count as results, of `pooling.pool_runs`.
        measure: measure that is aggregated.
    """
    counted, quantity = runs[runs[measure].notna()], QUANTITIES[measure]
    profiles = [
        profile_chart(table, quantity, f"profiles-{count}", f"Performance profiles, {where}", CAPTION)
        for count, (where, table) in enumerate(performance_profiles(runs, measure), start=1)
    ]
    return {
        "rows": overall_rows(runs, measure),
        "over": " / ".join(map(str, THRESHOLDS)),
        "charts": list(map(on_page, profiles)),
        "quantity": quantity,
        "caveat": caveat(counted.groupby([*COMPARED, "teacher"], dropna=False)["run_id"].nunique().min()),
    }
