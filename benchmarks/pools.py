"""Command line of benchmarks that run in processes of one machine, without Ray."""

from __future__ import annotations

import argparse
import itertools
import signal
import threading
import time
from pathlib import Path

from processes import LocalExecutor

from tma_ray.campaign.plan import Plan, lease_holder
from tma_ray.campaign.progress import ProgressView
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.results import TABLES, Committer, Lease, Results, Store, add_shard, start_from
from tma_ray.results.layout import ROOT_FILE
from tma_ray.runs import Placement
from tma_ray.runs.inputs import RunInputs
from tma_ray.students.rollout_workers import CohortSettings

REPORT_SECONDS = 20.0
"""Time between two lines of progress, s."""

GRACE_SECONDS = 600.0
"""Longest wait for the checkpoints of a stop, s: a first update may be compiled for minutes."""


def parser(description: str) -> argparse.ArgumentParser:
    """Return a parser with the options of a pool."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=description)
    parser.add_argument("--results", required=True, help="results root; what it holds is not done again")
    parser.add_argument("--start-from", help="release whose runs are copied first, and not done again")
    parser.add_argument("--grow", help="small root that is copied first, and gets the runs that have ended")
    parser.add_argument("--processes", type=int, default=2, help="runs at a time")
    parser.add_argument("--cohort", type=int, default=0, help="slots of a cohort; 0: each run learns alone")
    parser.add_argument("--device", default="cpu", help="where the cohort learns, or each run")
    parser.add_argument("--compiled", action="store_true", help="compile the cohort's updates")
    parser.add_argument("--minutes", type=float, default=9.0, help="after which runs leave with checkpoints")
    parser.add_argument("--order", default="0:", help="slice of the plan's runs, as 0:50")
    return parser


def execute(plan: Plan, options: argparse.Namespace) -> None:
    """Execute the unfinished runs of a plan with the options of `parser`, and print the progress.

    SIGTERM ends it with checkpoints, as does the end of the last minute.
    """
    terminated = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: terminated.set())
    deadline = time.monotonic() + 60 * options.minutes
    if options.start_from:
        start_from(Store.open(options.results), Store.open(options.start_from))
    if options.grow and Store.open(options.grow).exists(ROOT_FILE):
        start_from(Store.open(options.results), Store.open(options.grow))
    committer = Committer.open(options.results)
    runs = plan.runs[slice(*(int(part) if part else None for part in options.order.split(":")))]
    width = options.cohort
    settings = CohortSettings(options.device, width, options.compiled) if width else None
    placement = Placement("cpu" if width else options.device)
    with Lease(committer.store, lease_holder(plan.name)) as lease:
        committer.write_cells(plan.name, plan.cell_rows)
        RunInputs.of(runs).keep(committer.store)
        executor = LocalExecutor(committer.store, placement, options.processes, settings)
        view = ProgressView(line_seconds=REPORT_SECONDS)
        scheduler = Scheduler(
            committer, executor, ExecutionConfig(grace_seconds=GRACE_SECONDS), view, lease.keep
        )

        def stop() -> bool:
            return terminated.is_set() or time.monotonic() > deadline or lease.asked_to_stop()

        scheduler.execute(runs, stop)
    if options.grow:
        grown = Store.open(options.grow)
        shards = {Path(path).stem for path in grown.files(TABLES)}
        name = next(name for number in itertools.count() if (name := f"part-{number}") not in shards)
        print(f"{add_shard(Results.open(options.results), grown, name).runs} runs added to {options.grow}")
