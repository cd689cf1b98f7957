"""Descriptions of baselines: the card (``README.md``) and Croissant metadata (``croissant.json``).

The card states content, origin, use and citation. The metadata, for data-set search engines and loaders,
follow MLCommons' Croissant 1.0 with fields of its vocabulary for responsible AI (RAI 1.0).
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Final

import pyarrow as pa

from analysis.baselines.catalogue import BaselineFile, BaselineKind, BaselineManifest
from analysis.data.frames import Frames
from analysis.data.specs import parsed
from analysis.formatting import steps_text
from analysis.names import label, teacher_order
from analysis.tables.table import ResultTable, TableFormat, render
from tma_ray.results import CHIPMUNK, SCHEMAS, SIMULATED, Table
from tma_ray.support.texts import rounded_duration

CARD_FILE = "README.md"

LIBRARIES: Final = ("python", "tma_ray", "torch", "numpy", "pymunk")
"""Fingerprint entries shown on a card."""


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
        made: sentences about the origin of the results.
        tables: tables of results.
        citation: citation; empty for `BaselineManifest.citation`.
        ceilings: sentences about the bounds of the results.
        paths: paths of non-empty files of tables, for a configuration of the data set per table.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # deferred: needed only for cards

    environment = Environment(  # noqa: S701 - Markdown, with all values escaped
        loader=PackageLoader("analysis.baselines"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    folders = sorted({PurePosixPath(path).parent for path in paths})
    text = environment.get_template("card.md.j2").render(
        manifest=manifest,
        published=manifest.kind is BaselineKind.PUBLISHED,
        holds=[(name.replace("_", " "), _plain(name, value)) for name, value in manifest.holds.items()],
        planned=", ".join(f"{_safe(name)} {count:,}" for name, count in sorted(manifest.planned.items())),
        configurations={folder.name: f"{folder}/*.parquet" for folder in folders},
        made=made,
        citation=citation or manifest.citation,
        ceilings=ceilings,
        tables="\n".join(render(table, TableFormat.MARKDOWN) for table in tables),
    )
    return re.sub(r"\n{3,}", "\n\n", text.rstrip()) + "\n"


def holdings(columns: Mapping[str, Sequence[Any]], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the contents of a baseline as JSON values: distinct values by column, and the given counts."""
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
    """Escape Markdown's special characters in `text`."""
    return re.sub(r"[^\w +./:=-]", lambda match: f"&#{ord(match[0])};", text)


def _ranges(numbers: Sequence[int]) -> str:
    """Format integers as ranges, such as "0 to 2, 5" for 0, 1, 2, 5."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{low} to {high}" if high > low else f"{low}" for low, high in runs)


def origin(frames: Frames, physics_versions: Sequence[int]) -> str:
    """Return sentences about the origin of runs: engines, attempts, specifications."""
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
    """Return sentences about the durations, machines, processors and software of attempts."""
    attempts, run_ids = frames.attempts, frames.attempts["run_id"].astype(str)
    hosts = attempts["host"].astype(str)
    machines = f", on machines: {hosts[hosts != ''].nunique()}" if (hosts != "").any() else ""
    median = float(3600 * frames.run_hours.median())  # not the mean, which stalled runs would dominate
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


CROISSANT_FILE: Final = "croissant.json"

_CONTEXT: Final[dict[str, Any]] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "data": {"@id": "cr:data", "@type": "@json"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{
        name: f"cr:{name}"
        for name in (
            *("citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty"),
            *("fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField"),
            *("path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
            *("separator", "source", "subField", "transform"),
        )
    },
}
"""Context recommended by the Croissant specification."""

_ROWS: Final = {
    Table.RUNS: "one run: its specification (JSON), state and versions",
    Table.ATTEMPTS: "one attempt at a run: when, for how long, with which hardware and software",
    Table.CELLS: "one cell of a campaign and its run",
    Table.EVALUATIONS: "the return of one test task at one evaluation of a run",
    Table.TRAINING: "one window of training of a run: episodes and their returns",
    Table.EPISODES: "one training episode of a run and its task",
    Table.CURRICULUM: "one task that the teacher would teach, probed without exploration",
    Table.TEACHER_LOG: "one update of a teacher: its Gaussians, boxes and scalars",
}


_TYPES: Final = {
    pa.types.is_boolean: "sc:Boolean",
    pa.types.is_integer: "sc:Integer",
    pa.types.is_floating: "sc:Float",
    pa.types.is_string: "sc:Text",
    pa.types.is_timestamp: "sc:Date",
}


def croissant(
    manifest: BaselineManifest, files: Sequence[BaselineFile], made: str, columns: Mapping[str, set[str]]
) -> dict[str, Any]:
    """Return the Croissant metadata of a release of runs, as JSON values.

    Args:
        manifest: manifest of the baseline.
        files: files of the baseline.
        made: sentences about the origin of the results.
        columns: names of the columns of each file of a table, by path. Loaders fail for a field without a
            column, so only the columns that all files of a table have are described.
    """
    tables = {table: [f for f in files if f.path.startswith(f"tables/{table}/")] for table in Table}
    held = {table: parts for table, parts in tables.items() if parts}
    numbers = [part for part in manifest.name.rpartition("-")[2].split(".") if part.isdigit()]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": manifest.name,
        "description": (
            f"Results of {manifest.holds['runs']:,} training runs of a benchmark of curriculum teachers for "
            f"deep reinforcement learning: which teachers help which students to master which tasks."
        ),
        **({"license": manifest.licence} if manifest.licence else {}),
        "url": f"./{manifest.name}",
        "version": ".".join([*numbers, "0", "0", "0"][:3]),  # 1.2.0 for a release named mine-1.2
        "datePublished": manifest.created[:10],
        "creator": {"@type": "sc:Organization", "name": manifest.software},
        "citeAs": manifest.citation,
        "rai:dataCollection": made,
        "rai:dataCollectionType": "Software Collection",
        "rai:dataUseCases": "Comparison of curriculum teachers by released runs, without running them again.",
        "rai:dataLimitations": [*manifest.caveats, *filter(None, (manifest.gaps, manifest.budget_note))],
        "rai:dataBiases": (
            "Runs are of simulated worlds and of the students that are named; hardware can go with seeds."
        ),
        "rai:personalSensitiveInformation": "None: all data come from simulations.",
        "distribution": [entry for table, parts in held.items() for entry in _distribution(table, parts)],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": str(table),
                "name": str(table),
                "description": f"A row is {_ROWS[table]}.",
                "field": [
                    field
                    for column in SCHEMAS[table]
                    if all(column.name in columns[file.path] for file in parts)
                    and (field := _field(table, column))
                ],
            }
            for table, parts in held.items()
        ],
    }


def _distribution(table: Table, files: Sequence[BaselineFile]) -> Iterator[dict[str, Any]]:
    """Yield an entry for each file of a table, and one for the set of all its files."""
    for file in files:
        yield {
            "@type": "cr:FileObject",
            "@id": file.path,
            "name": file.path,
            "contentUrl": file.path,
            "contentSize": f"{file.size} B",
            "encodingFormat": "application/x-parquet",
            "sha256": file.sha256,
        }
    yield {
        "@type": "cr:FileSet",
        "@id": f"{table}-files",
        "name": f"{table}-files",
        "encodingFormat": "application/x-parquet",
        "includes": f"tables/{table}/*.parquet",
    }


def _field(table: Table, column: pa.Field) -> dict[str, Any] | None:
    """Return the Croissant field of a column, or None for structs and maps."""
    kind, repeated = column.type, pa.types.is_list(column.type)
    kind = kind.value_type if repeated else kind
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    name = next((name for fits, name in _TYPES.items() if fits(kind)), None)
    if name is None:
        return None
    unit = (column.metadata or {}).get(b"unit", b"").decode()
    return {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": column.name,
        "description": unit or column.name.replace("_", " "),
        "dataType": name,
        **({"repeated": True} if repeated else {}),
        "source": {"fileSet": {"@id": f"{table}-files"}, "extract": {"column": column.name}},
    }
