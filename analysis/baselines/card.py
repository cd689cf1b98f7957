"""The card of a baseline, ``README.md``: what it is, how it was made, how to use and to cite it."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Final

from analysis.baselines.catalogue import BaselineKind, BaselineManifest
from analysis.data.frames import Frames
from analysis.data.identity import parsed
from analysis.formatting import amount, duration
from analysis.names import label, teacher_order
from analysis.tables.table import ResultTable, TableFormat, render
from tma_ray.results import CHIPMUNK, SIMULATED

CARD_FILE = "README.md"

LIBRARIES: Final = ("python", "tma_ray", "torch", "numpy", "pymunk")
"""Entries of a fingerprint that the card of a release shows."""


def card(
    manifest: BaselineManifest,
    made: str,
    tables: Iterable[ResultTable],
    citation: str = "",
    ceilings: Sequence[str] = (),
    paths: Iterable[str] = (),
) -> str:
    """Return the card of a baseline.

    Args:
        manifest: manifest of the baseline.
        made: origin of its results, in words.
        tables: its results.
        citation: text that others cite; empty for name, software and date of the baseline itself.
        ceilings: bounds of its results, a sentence each.
        paths: paths of its tables' files that have rows; each table is a configuration of the data set.
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
        configurations=_configurations(paths),
        made=made,
        citation=citation or manifest.citation,
        ceilings=ceilings,
        tables="\n".join(render(table, TableFormat.MARKDOWN) for table in tables),
    )
    return re.sub(r"\n{3,}", "\n\n", text.rstrip()) + "\n"


def _configurations(paths: Iterable[str]) -> dict[str, str]:
    """Return the pattern of the files of each table by its name, since libraries load one table at a time."""
    folders = sorted({PurePosixPath(path).parent for path in paths})
    return {folder.name: f"{folder}/*.parquet" for folder in folders}


def holdings(columns: Mapping[str, Sequence[Any]], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the sorted distinct values of some columns, and some counts, as JSON values."""
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
    """Return a name from outside with the characters escaped that Markdown or a table would interpret."""
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


def origin(frames: Frames, physics_versions: Sequence[int]) -> str:
    """Return the engines, hours, machines, processors and software behind runs, in words."""
    engines = set(frames.cells["engine"])
    others = sorted(engines - {CHIPMUNK, SIMULATED})
    said = [f"Imported from results that others made in worlds of {', '.join(others)}."] if others else []
    if SIMULATED in engines:
        said.append("By `tma-ray simulate`: students are equations, without physics.")
    if CHIPMUNK in engines:
        versions = ", ".join(map(str, physics_versions)) or "unknown"
        said.append(f"By campaigns of tma_ray with its {CHIPMUNK} worlds, physics version {versions}.")
    if len(frames.attempts):
        said += _made_on(frames)
    return " ".join(
        [*said, "Every run has its whole specification in the column `spec` of the table `runs`."]
    )


def _made_on(frames: Frames) -> list[str]:
    """Return sentences on the attempts at runs: time, machines, processors and software."""
    attempts, run_ids = frames.attempts, frames.attempts["run_id"].astype(str)
    hosts = attempts["host"].astype(str)
    machines = f", on machines: {hosts[hosts != ''].nunique()}" if (hosts != "").any() else ""
    usual = float(3600 * frames.run_hours.median())  # a few stalled runs would decide a mean
    said = [f"Attempts: {len(attempts):,}{machines}; a run takes {duration(usual)} in the median."]
    texts = attempts["fingerprint"].astype(str)
    prints = {each: parsed(each) for each in texts.unique()}
    seeds = run_ids.map(frames.cells.drop_duplicates("run_id").set_index("run_id")["seed"])
    used = seeds.groupby(texts.map(lambda each: prints[each].get("cpu")))
    by_processor = {str(cpu): sorted(set(rows.dropna().astype(int))) for cpu, rows in used}
    if by_processor:
        shown = ", ".join(
            f"{cpu} ({'seeds' if len(mine) > 1 else 'seed'} {_ranges(mine)})"
            for cpu, mine in by_processor.items()
        )
        devices = set()
        for each in prints.values():
            model = f" ({each['gpu']})" if "gpu" in each else ""
            cohort = f" in cohorts of {each['cohort']}" if "cohort" in each else ""
            devices.add(f"{each.get('device', 'cpu')}{model}{cohort}")
        said.append(f"Processors: {shown}; devices: {', '.join(sorted(devices))}.")
        if len(set(map(tuple, by_processor.values()))) > 1:
            said.append("Processors differ between seeds and between teachers.")
    values = {name: {str(each[name]) for each in prints.values() if name in each} for name in LIBRARIES}
    versions = [f"{name} {', '.join(sorted(found))}" for name, found in values.items() if found]
    return [*said, f"Software: {'; '.join(versions)}."] if versions else said
