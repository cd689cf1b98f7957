"""The card of a baseline, ``README.md``: what it is, how it was made, how to use and to cite it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pandas as pd

from analysis.baselines.catalogue import BaselineKind, BaselineManifest
from analysis.data.identity import parsed
from analysis.formatting import amount, duration
from analysis.names import label, teacher_order
from analysis.tables.table import Table, TableFormat, render

CARD_FILE = "README.md"


def card(
    manifest: BaselineManifest,
    made: str,
    citation: str = "",
    tables: Sequence[Table] = (),
    ceilings: Sequence[str] = (),
) -> str:
    """Return the card of a baseline.

    Args:
        manifest: manifest of the baseline.
        made: origin of its results, in words.
        citation: text that others cite; empty for name, software and date of the baseline itself.
        tables: its results.
        ceilings: bounds of these, a sentence each.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # reading a baseline does without

    # Markdown, and every value has been escaped or is ours.
    environment = Environment(  # noqa: S701
        loader=PackageLoader("analysis.baselines"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template("card.md.j2").render(
        manifest=manifest,
        published=manifest.kind is BaselineKind.PUBLISHED,
        holds=[(name.replace("_", " "), _plain(name, value)) for name, value in manifest.holds.items()],
        planned=", ".join(f"{_safe(name)} {count:,}" for name, count in sorted(manifest.planned.items())),
        made=made,
        citation=citation or manifest.citation,
        ceilings=ceilings,
        tables="\n".join(render(table, TableFormat.MARKDOWN) for table in tables),
    )
    return re.sub(r"\n{3,}", "\n\n", text.rstrip()) + "\n"


def holdings(columns: Mapping[str, Sequence[Any]], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the distinct values of some columns, sorted, and some counts, as JSON has them."""
    found = {name: sorted(set(values)) for name, values in columns.items()}
    return {name: values for name, values in found.items() if values and values != [""]} | dict(counts)


def _plain(name: str, value: Any) -> str:
    if name == "steps":
        return ", ".join(map(amount, value))
    if name == "teachers":
        return ", ".join(_safe(label(teacher)) for teacher in sorted(value, key=teacher_order))
    if name == "seeds":
        return _ranges(value)
    return ", ".join(_safe(str(each)) for each in value) if isinstance(value, list) else f"{value:,}"


def _safe(text: str) -> str:
    """Return a name that may be somebody else's, without what Markdown or a table would take for its own."""
    return "".join(each if each.isalnum() or each in " _-+./:=" else f"&#{ord(each)};" for each in text)


def _ranges(numbers: Sequence[int]) -> str:
    """Return 0, 1, 2, 5 as "0 to 2, 5"."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{low} to {high}" if high > low else f"{low}" for low, high in runs)


LIBRARIES: Final = ("python", "tma_ray", "torch", "numpy", "pymunk")
"""Entries of a fingerprint that the card of a release shows."""


def made_on(attempts: pd.DataFrame, seeds: pd.Series) -> str:
    """Return hours, machines, processors and software of the attempts at runs, in words.

    Args:
        attempts: table of attempts, at least one.
        seeds: seed of each run, indexed by its id.
    """
    hosts = attempts["host"].astype(str)
    machines = f", on machines: {hosts[hosts != ''].nunique()}" if (hosts != "").any() else ""
    spent = attempts["wall_seconds"].astype(float).groupby(attempts["run_id"].astype(str)).sum()
    usual = float(spent.median())  # a few stalled runs would decide a mean
    text = f"Attempts: {len(attempts):,}{machines}; a run takes {duration(usual)} in the median."
    texts = attempts["fingerprint"].astype(str)
    prints = {each: parsed(each) for each in texts.unique()}
    known = list(prints.values())
    used = attempts["run_id"].astype(str).map(seeds).groupby(texts.map(lambda each: prints[each].get("cpu")))
    by_processor = {str(cpu): sorted(set(rows.dropna().astype(int))) for cpu, rows in used}
    if by_processor:
        shown = [f"{cpu} (seeds {_ranges(mine)})" for cpu, mine in by_processor.items()]
        text += f" Processors: {', '.join(shown)}; devices: {', '.join(_devices(known))}."
        if len(set(map(tuple, by_processor.values()))) > 1:
            text += " Hardware goes with seeds: a difference between seeds may be one between processors."
    versions = [f"{name} {', '.join(_values(known, name))}" for name in LIBRARIES if _values(known, name)]
    return f"{text} Software: {'; '.join(versions)}." if versions else text


def _devices(prints: list[dict[str, Any]]) -> list[str]:
    """Return each device, with the model of a GPU and the width of a cohort."""
    shown = set()
    for each in prints:
        text = str(each.get("device", "cpu"))
        if "gpu" in each:
            text += f" ({each['gpu']})"
        if "cohort" in each:
            text += f" in cohorts of {each['cohort']}"
        shown.add(text)
    return sorted(shown)


def _values(prints: list[dict[str, Any]], name: str) -> list[str]:
    return sorted({str(each[name]) for each in prints if name in each})
