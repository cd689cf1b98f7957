"""Common parts of pages: templates, controls, and the section about all challenges."""

import base64
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from analysis.charts.intervals import FEWEST_WITH_BAND, profile_chart
from analysis.charts.page import on_page, packed, plotly_library
from analysis.comparisons.leaderboards import THRESHOLDS, overall_rows, performance_profiles
from analysis.data.columns import COMPARED, FILTERS, PARTS
from analysis.formatting import few_seeds_warning, plus_minus, steps_text
from analysis.measures.tested import HEADLINE, QUANTITIES
from analysis.names import challenge_title, label, mark_of, marked_label, teacher_order
from analysis.statistics import SIGNIFICANCE
from analysis.teacher_styles import teacher_style
from tma_ray.console.exit_codes import installed_version
from tma_ray.support.texts import visible


def page(template: str, **content: Any) -> str:
    """Render a page from a template and its content."""
    version, written = installed_version("tma_ray"), datetime.now(UTC)
    environment = _environment()
    return environment.get_template(template).render(
        version=version, written=written, significance=SIGNIFICANCE, **content
    )


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
    environment.policies["json.dumps_kwargs"] = {}  # by default, jinja2 sorts keys
    environment.filters["data_uri"] = lambda content, kind: (
        f"data:{kind};base64,{base64.b64encode(content).decode()}"
    )
    environment.filters["packed"] = lambda text: packed(str(text))
    environment.globals |= {"plotly_library": plotly_library, "plus_minus": plus_minus}
    environment.globals |= {"label": marked_label, "teacher_style": teacher_style, "mark_of": mark_of}
    return environment


def page_folder(root: str | Path, output: Path | None, name: str, what: str) -> Path:
    """Return the folder of a page about `root`: `output` if given, else `name` in `root`.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        output: folder that the user requested, if any.
        name: name of the folder.
        what: kind of page, for messages.

    Raises:
        ValueError: without `output`, if `root` is an object store or has links.
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


def write_page(folder: Path, text: str, files: Mapping[str, bytes]) -> Path:
    """Write a page as ``index.html`` into a folder, along with other named files, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    index = folder / "index.html"
    index.write_text(text, encoding="utf-8")
    return index


def controls(
    comparisons: pd.DataFrame, teachers: Iterable[str], steps: Iterable[int], shown: Collection[str]
) -> dict[str, Any] | None:
    """Return the controls with which readers choose what a page shows, or None if there is nothing to choose.

    Args:
        comparisons: a row per comparison, with some of the columns `FILTERS`.
        teachers: teachers of the page.
        steps: steps at which students were evaluated.
        shown: teachers that are shown at first.

    Returns:
        teachers (that may be left out), filters (columns with several values, and their labels) and steps of
        evaluations in ascending order with their labels.
    """
    named = [
        {"name": teacher, "shown": teacher in shown}
        for teacher in sorted(set(map(str, teachers)), key=teacher_order)
    ]
    filters = []
    for column, name in FILTERS.items():
        if column not in comparisons:
            continue
        values = list(dict.fromkeys(map(str, comparisons[column])))
        # If every experiment is named like its challenge, a filter by experiment would be redundant.
        repeated = column == "experiment" and bool((comparisons[column] == comparisons["challenge"]).all())
        if len(values) > 1 and not repeated:
            environments = comparisons["environment"].unique() if "environment" in comparisons else ()
            filters.append((column, name, [(value, _name(column, value, environments)) for value in values]))
    read_at = [(step, f"{steps_text(step)} steps") for step in sorted(set(map(int, steps)))]
    content = {"teachers": named, "filters": filters, "steps": read_at}
    return content if len(named) > 1 or filters or len(read_at) > 1 else None


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


CAPTION = (
    "Share of runs that master more of the test tasks than the horizontal axis says; bands are exact 95 % "
    f"intervals, threshold by threshold, of {FEWEST_WITH_BAND} runs and more; all challenges together."
)


def overall_section(runs: pd.DataFrame, measure: str = HEADLINE) -> dict[str, Any]:
    """Return the content of the page section about all challenges together, as template variables.

    Args:
        runs: rows from `pooling.pool_runs` for all results.
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
        "caveat": few_seeds_warning(
            counted.groupby([*COMPARED, *PARTS, "teacher"], dropna=False)["run_id"].nunique().min()
        ),
    }
