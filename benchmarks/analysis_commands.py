"""Processor time of commands that read results, on a root of thousands of runs in separate files.

    python benchmarks/analysis_commands.py --seeds 25 --steps 500000 --output analysis_commands.json

Writes the runs of the full benchmark with the given seeds, in separate files per run as in a campaign, unless
`--root` exists; then every command reads the root in a new process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from analysis_scale import attempt, full_plan, scale_parser, synthetic_rows

from tma_ray.campaign import Plan
from tma_ray.results import DATA_TABLES, SCHEMAS, Committer, Manifest, PartFile, RunStatus, Table
from tma_ray.results.layout import manifest_path, table_path
from tma_ray.results.parquet import encode
from tma_ray.results.schema import to_arrow

COMMANDS = {
    "status": ["status", "{root}"],
    "ranking": ["ranking", "{root}"],
    "report": ["report", "{root}", "--output", "{page}"],
}


def write_separately(root: Path, plan: Plan) -> None:
    """Write synthetic results of all runs of a plan, with one file per table and run (not merged)."""
    committer = Committer.open(root)
    committer.write_cells(plan.name, plan.cell_rows)
    store = committer.store
    for spec in plan.runs:
        rows = {table: synthetic_rows(table, spec) for table in DATA_TABLES}
        files = tuple(
            PartFile.write(store, table_path(table, spec.run_id), table, len(each), encode(table, each))
            for table, each in rows.items()
            if len(each)
        )
        manifest = Manifest(spec.record(), RunStatus.DONE, 0, files)
        store.write_bytes(manifest_path(spec.run_id), manifest.to_bytes())
        for table, record in ((Table.RUNS, manifest.row()), (Table.ATTEMPTS, attempt(spec))):
            content = to_arrow(table, SCHEMAS[table], [record])
            store.write_bytes(table_path(table, spec.run_id), encode(table, content))


def processor_seconds(command: list[str]) -> float:
    """Return the processor time of a `tma-ray` command, user and system, in s."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "tma_ray", *command], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return round(sum(after[2:4]) - sum(before[2:4]), 2)


def main() -> None:
    """Print the measured times, and write them as JSON."""
    parser = scale_parser(__doc__, Path("build/separate_runs"), Path("analysis_commands.json"))
    arguments = parser.parse_args()
    plan = full_plan(arguments.seeds, arguments.steps)
    if not arguments.root.exists():
        write_separately(arguments.root, plan)
    page = arguments.root.with_name(f"{arguments.root.name}_page")
    places = {"root": str(arguments.root), "page": str(page)}
    result: dict[str, float] = {"runs": len(list((arguments.root / "manifests").iterdir()))}
    for name, command in COMMANDS.items():
        result[f"{name}_seconds"] = processor_seconds([part.format(**places) for part in command])
    result["report_megabytes"] = round((page / "index.html").stat().st_size / 1e6, 1)
    print(json.dumps(result))
    arguments.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
