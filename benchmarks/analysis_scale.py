"""Time and memory to load and analyse synthetic results of the size of the full benchmark.

    python benchmarks/analysis_scale.py --output analysis_scale.json

Writes a results root as large as the full benchmark of the paper (6,432 runs of 41 evaluations of 100 test
tasks, with training windows and curricula), merged by experiment, unless `--root` exists; then loads it and
makes all tables in a new process. `--seeds` and `--steps` make it smaller.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from tma_ray.benchmark import TEACHERS, find_experiment
from tma_ray.campaign import Plan, joined_plan, matrix_campaigns
from tma_ray.results import (
    DATA_TABLES,
    SCHEMAS,
    AttemptOutcome,
    AttemptRecord,
    Committer,
    Manifest,
    PartFile,
    RunStatus,
    Store,
    Table,
)
from tma_ray.results.layout import manifest_path, table_path
from tma_ray.results.parquet import encode, encode_together
from tma_ray.results.schema import to_arrow
from tma_ray.runs import RunSpec
from tma_ray.support.quantities import COUNT

SKILL = {teacher: 0.2 + 0.05 * place for place, teacher in enumerate(TEACHERS)}
"""Share of the test tasks that a teacher's students master in the end."""


def full_plan(seeds: int | None, steps: int | None) -> Plan:
    """Return the plan of the full benchmark, with a separate run for every cell and seed.

    Args:
        seeds: number of seeds of each cell; None for all.
        steps: number of steps of each run; None for those of the schedule.
    """
    experiment = find_experiment("full_benchmark")
    matrices = [replace(matrix, seeds=matrix.seeds[:seeds]) for matrix in experiment.matrices]
    campaigns = matrix_campaigns(matrices, experiment.teachers)
    changed = [
        replace(
            each, independent_levels=True, schedule=replace(each.schedule, steps=steps or each.schedule.steps)
        )
        for each in campaigns
    ]
    return joined_plan(experiment.name, changed)


def write_root(root: Path, plan: Plan) -> None:
    """Write synthetic results of all runs of a plan, merged by experiment."""
    committer = Committer.open(root)
    committer.write_cells(plan.name, plan.cell_rows)
    experiments: dict[str, list[RunSpec]] = {}
    specs = {spec.run_id: spec for spec in plan.runs}
    for row in plan.cell_rows:
        experiments.setdefault(row["experiment"], []).append(specs[row["run_id"]])
    for name, runs in experiments.items():
        print(f"{name}: {len(runs)} runs", file=sys.stderr)
        write_experiment(committer.store, name, runs)


def write_experiment(store: Store, name: str, runs: Sequence[RunSpec]) -> None:
    """Write the results of an experiment: one file per table, and a manifest per run."""
    slices: dict[str, list[PartFile]] = {spec.run_id: [] for spec in runs}
    for table in DATA_TABLES:
        counts: dict[str, int] = {}

        def parts(table: Table = table, counts: dict[str, int] = counts) -> Iterator[pa.Table]:
            for spec in runs:
                rows = synthetic_rows(table, spec)
                counts[spec.run_id] = len(rows)
                yield rows

        data = encode_together(table, parts())
        file = PartFile.write(store, table_path(table, name), table, sum(counts.values()), data)
        first = 0
        for run_id, count in counts.items():
            slices[run_id].append(replace(file, rows=count, first=first))
            first += count
    manifests = [Manifest(spec.record(), RunStatus.DONE, 0, tuple(slices[spec.run_id])) for spec in runs]
    for manifest in manifests:
        store.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    about = {Table.RUNS: [m.row() for m in manifests], Table.ATTEMPTS: [attempt(spec) for spec in runs]}
    for table, records in about.items():
        content = to_arrow(table, SCHEMAS[table], records)
        store.write_bytes(table_path(table, name), encode(table, content))


def attempt(spec: RunSpec) -> dict[str, Any]:
    """Return a synthetic row of the table of attempts."""
    began = datetime(2026, 1, 1, tzinfo=UTC)
    return vars(AttemptRecord(spec.run_id, 0, began, 1e5, 150.0, "node", "{}", AttemptOutcome.DONE))


def synthetic_rows(table: Table, spec: RunSpec) -> pa.Table:
    """Return synthetic rows of one run in a table, empty if the analysis does not read it."""
    rng = np.random.default_rng([spec.seed, *spec.teacher.encode(), *spec.expert_knowledge.encode()])
    schedule = spec.schedule
    if table is Table.EVALUATIONS:
        steps = np.arange(0, schedule.steps + 1, schedule.evaluation_interval)
        count, tasks = len(spec.test_set), spec.test_set.tasks
        share = SKILL[spec.teacher] * steps / schedule.steps
        mastered = rng.random((len(steps), count)) < share[:, None]
        columns = {
            "step": np.repeat(steps, count),
            "test_set": _constant(spec.test_set.name, mastered.size),
            "task_index": np.tile(np.arange(count, dtype=np.int32), len(steps)),
            "task": _vectors(np.tile(tasks, (len(steps), 1))),
            "episodic_return": np.where(mastered, 300.0, 0.0).ravel() + rng.normal(0, 20, mastered.size),
            "length": rng.integers(100, 2_000, mastered.size, dtype=np.int32),
        }
    elif table is Table.TRAINING:
        steps = np.arange(schedule.training_window, schedule.steps + 1, schedule.training_window)
        columns = {"step": steps, "episodes": np.full(len(steps), 500)}
        columns |= {
            name: rng.normal(100, 20, len(steps)) for name in ("mean_return", "std_return", "mean_length")
        }
        columns["success_share"] = rng.random(len(steps))
    elif table is Table.CURRICULUM:
        steps = np.arange(0, schedule.steps + 1, schedule.probe_interval)
        size = len(steps) * schedule.probe_size
        columns = {
            "step": np.repeat(steps, schedule.probe_size),
            "sample": np.tile(np.arange(schedule.probe_size, dtype=np.int32), len(steps)),
            "task": _vectors(spec.task_space.sample(rng, size)),
        }
    else:
        return SCHEMAS[table].empty_table()
    rows = len(columns["step"])
    arrays = {"run_id": _constant(spec.run_id, rows)} | columns
    return pa.table(
        [
            pa.array(arrays[name]) if not isinstance(arrays[name], pa.Array) else arrays[name]
            for name in SCHEMAS[table].names
        ],
        schema=SCHEMAS[table],
    )


def _constant(text: str, count: int) -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int32)), pa.array([text]))


def _vectors(tasks: np.ndarray) -> pa.Array:
    kind = SCHEMAS[Table.CURRICULUM].field("task").type
    offsets = np.arange(0, tasks.size + 1, tasks.shape[1], dtype=np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(tasks.ravel().astype(np.float32)), type=kind)


def measure(root: Path) -> dict[str, Any]:
    """Load a root and render all tables; return sizes, seconds and peak memory."""
    from analysis.commands.paper import tables_of
    from analysis.data.loading import load
    from analysis.tables.table import TableFormat, render

    start = time.perf_counter()
    frames = load(root)
    loaded = time.perf_counter()
    texts = [render(table, TableFormat.MARKDOWN) for table in tables_of(frames)]
    done = time.perf_counter()
    return {
        "runs": len(frames.cells),
        "evaluation_rows": len(frames.evaluations),
        "tables": len(texts),
        "load_seconds": round(loaded - start, 2),
        "tables_seconds": round(done - loaded, 2),
        "peak_gib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


def scale_parser(description: str | None, root: Path, output: Path) -> argparse.ArgumentParser:
    """Return a parser with the options of the runs, their root, and the output file."""
    parser = argparse.ArgumentParser(
        allow_abbrev=False, description=description.splitlines()[0] if description else None
    )
    parser.add_argument("--root", type=Path, default=root, help="(%(default)s)")
    parser.add_argument("--seeds", type=int, help="of each cell (all)")
    parser.add_argument("--steps", type=COUNT, help="of each run (those of the paper)")
    parser.add_argument("--output", type=Path, default=output)
    return parser


def main() -> None:
    """Print the measurements, and write them as JSON."""
    parser = scale_parser(__doc__, Path("build/full_benchmark"), Path("analysis_scale.json"))
    parser.add_argument("--measure", action="store_true", help="only measure --root, in this process")
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments.root)))
        return
    if not arguments.root.exists():
        write_root(arguments.root, full_plan(arguments.seeds, arguments.steps))
    command = [sys.executable, __file__, "--measure", "--root", str(arguments.root)]
    result = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    print(json.dumps(result))
    arguments.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
