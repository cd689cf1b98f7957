"""Croissant metadata of a release (``croissant.json``) for data-set search engines and loaders.

The format is MLCommons' Croissant 1.0 with fields of its vocabulary for responsible AI (RAI 1.0).
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import pyarrow as pa

from analysis.baselines.catalogue import BaselineFile, BaselineManifest
from tma_ray.results import SCHEMAS, Table

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
"""Recommended context of the specification."""

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


def croissant(manifest: BaselineManifest, files: Sequence[BaselineFile], made: str) -> dict[str, Any]:
    """Return the Croissant metadata of a release of runs, as JSON values."""
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
        "version": ".".join([*numbers, "0", "0", "0"][:3]),  # such as 1.2.0 for mine-1.2
        "datePublished": manifest.created[:10],
        "creator": {"@type": "sc:Organization", "name": manifest.software},
        "citeAs": manifest.citation,
        "rai:dataCollection": made,
        "rai:dataCollectionType": "Software Collection",
        "rai:dataUseCases": "Comparison of curriculum teachers by released runs, without running them again.",
        "rai:dataLimitations": [*manifest.caveats, *([manifest.gaps] if manifest.gaps else [])],
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
                "field": [field for column in SCHEMAS[table] if (field := _field(table, column))],
            }
            for table in held
        ],
    }


def _distribution(table: Table, files: Sequence[BaselineFile]) -> Iterator[dict[str, Any]]:
    """Yield one entry per file of a table, and one for the set of all its files."""
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
