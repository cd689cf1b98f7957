"""Baseline cards (``README.md``): content, origin, use and citation of a baseline."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Final

from analysis.baselines.catalogue import BaselineKind, BaselineManifest
from analysis.data.frames import Frames
from analysis.data.specs import parsed
from analysis.formatting import steps_text
from analysis.names import label, teacher_order
from analysis.tables.table import ResultTable, TableFormat, render
from tma_ray.results import CHIPMUNK, SIMULATED
from tma_ray.support.texts import rounded_duration

CARD_FILE = "README.md"

LIBRARIES: Final = ("python", "tma_ray", "torch", "numpy", "pymunk")
"""Entries of a fingerprint that a card shows."""


def card(
    manifest: BaselineManifest,
    made: str,
    tables: Iterable[ResultTable],
    citation: str = "",
    ceilings: Sequence[str] = (),
    paths: Iterable[str] = (),
) -> str:
    """Return the Markdown text of a baseline card.

    Args:
        manifest: manifest of the baseline.
        made: sentences on the origin of the results.
        tables: tables of results.
        citation: citation; empty for `BaselineManifest.citation`.
        ceilings: sentences on the bounds of the results.
        paths: paths of non-empty files of tables, for a configuration of the data set per table.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # deferred: only writing a card needs it

    environment = Environment(  # noqa: S701 - Markdown, with all values escaped
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
    """Return the glob pattern of each table's files, by table name."""
    folders = sorted({PurePosixPath(path).parent for path in paths})
    return {folder.name: f"{folder}/*.parquet" for folder in folders}


def holdings(columns: Mapping[str, Sequence[Any]], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the contents of a baseline as JSON values: distinct values by column, and counts."""
    distinct = {name: sorted(set(values)) for name, values in columns.items()}
    return {name: values for name, values in distinct.items() if values and values != [""]} | dict(counts)


def _plain(name: str, value: Any) -> str:
    if name == "steps":
        return ", ".join(map(steps_text, value))
    if name == "teachers":
        return ", ".join(_safe(label(teacher)) for teacher in sorted(value, key=teacher_order))
    if name == "seeds":
        return _ranges(value)
    return ", ".join(_safe(str(entry)) for entry in value) if isinstance(value, list) else f"{value:,}"


def _safe(text: str) -> str:
    """Escape Markdown's special characters in a text."""
    return re.sub(r"[^\w +./:=-]", lambda match: f"&#{ord(match[0])};", text)


def _ranges(numbers: Sequence[int]) -> str:
    """Return numbers as text with ranges: 0, 1, 2, 5 becomes "0 to 2, 5"."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{low} to {high}" if high > low else f"{low}" for low, high in runs)


def origin(frames: Frames, physics_versions: Sequence[int]) -> str:
    """Return sentences on the origin of runs: engines, attempts, specifications."""
    engines = set(frames.cells["engine"])
    others = sorted(engines - {CHIPMUNK, SIMULATED})
    sentences = (
        [f"Imported from results that others made in worlds of {', '.join(others)}."] if others else []
    )
    if SIMULATED in engines:
        sentences.append("By `tma-ray simulate`: students are equations, without physics.")
    if CHIPMUNK in engines:
        versions = ", ".join(map(str, physics_versions)) or "unknown"
        sentences.append(f"By campaigns of tma_ray with its {CHIPMUNK} worlds, physics version {versions}.")
    if len(frames.attempts):
        sentences += _made_on(frames)
    sentences.append("Every run has its whole specification in the column `spec` of the table `runs`.")
    return " ".join(sentences)


def _made_on(frames: Frames) -> list[str]:
    """Return sentences on the durations, machines, processors and software of attempts."""
    attempts, run_ids = frames.attempts, frames.attempts["run_id"].astype(str)
    hosts = attempts["host"].astype(str)
    machines = f", on machines: {hosts[hosts != ''].nunique()}" if (hosts != "").any() else ""
    median = float(3600 * frames.run_hours.median())  # stalled runs would dominate a mean
    sentences = [
        f"Attempts: {len(attempts):,}{machines}; a run takes {rounded_duration(median)} in the median."
    ]
    texts = attempts["fingerprint"].astype(str)
    fingerprints = {text: parsed(text) for text in texts.unique()}
    seeds = run_ids.map(frames.cells.drop_duplicates("run_id").set_index("run_id")["seed"])
    groups = seeds.groupby(texts.map(lambda text: fingerprints[text].get("cpu")))
    by_processor = {str(cpu): sorted(set(rows.dropna().astype(int))) for cpu, rows in groups}
    if by_processor:
        processors = ", ".join(
            f"{cpu} ({'seeds' if len(numbers) > 1 else 'seed'} {_ranges(numbers)})"
            for cpu, numbers in by_processor.items()
        )
        devices = set()
        for fingerprint in fingerprints.values():
            model = f" ({fingerprint['gpu']})" if "gpu" in fingerprint else ""
            cohort = f" in cohorts of {fingerprint['cohort']}" if "cohort" in fingerprint else ""
            devices.add(f"{fingerprint.get('device', 'cpu')}{model}{cohort}")
        sentences.append(f"Processors: {processors}; devices: {', '.join(sorted(devices))}.")
        if len(set(map(tuple, by_processor.values()))) > 1:
            sentences.append("Processors differ between seeds and between teachers.")
    values = {name: {str(fp[name]) for fp in fingerprints.values() if name in fp} for name in LIBRARIES}
    versions = [f"{name} {', '.join(sorted(texts))}" for name, texts in values.items() if texts]
    return [*sentences, f"Software: {'; '.join(versions)}."] if versions else sentences
