"""Command line of benchmarks that run in processes of one machine, without Ray."""

from __future__ import annotations

import argparse
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace

from tma_ray.campaign.executors.processes import PoolReport, cohort, run_in_processes
from tma_ray.campaign.plan import Plan, lease_holder
from tma_ray.results import Committer, Lease
from tma_ray.runs import Placement
from tma_ray.students.players import CohortSettings
from tma_ray.students.players.link import account

REPORT_SECONDS = 20.0
"""Time between two lines of progress, s."""


def parser(description: str) -> argparse.ArgumentParser:
    """Returns a parser with the options of a pool."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=description)
    parser.add_argument("--results", required=True, help="results root; what it holds is not done again")
    parser.add_argument("--processes", type=int, default=2, help="runs at a time")
    parser.add_argument("--cohort", type=int, default=0, help="slots of a cohort; 0: each run learns alone")
    parser.add_argument("--device", default="cpu", help="where the cohort learns, or each run")
    parser.add_argument("--compiled", action="store_true", help="compile the cohort's updates")
    parser.add_argument("--minutes", type=float, default=9.0, help="after which runs leave with checkpoints")
    parser.add_argument("--order", default="0:", help="slice of the plan's runs, as 0:50")
    return parser


def execute(plan: Plan, options: argparse.Namespace) -> PoolReport:
    """Executes the runs of `plan` that are not done, as the options say; returns how far they came.

    SIGTERM ends it as the last minute does, with checkpoints: it would leave the processes behind else.
    """
    terminated = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: terminated.set())
    deadline = time.monotonic() + 60 * options.minutes
    committer = Committer.open(options.results)
    runs = plan.runs[slice(*(int(part) if part else None for part in options.order.split(":")))]
    with ExitStack() as stack:
        lease = stack.enter_context(Lease(committer.store, lease_holder(plan.name)))
        committer.write_cells(plan.name, plan.cell_rows)
        placement = Placement(options.device)
        if options.cohort:
            settings = CohortSettings(options.device, options.cohort, options.compiled)
            learner = stack.enter_context(cohort(settings))
            placement = replace(placement, device="cpu", learner=learner)
            stack.callback(lambda: print({part: round(s, 1) for part, s in account(learner).items()}))
        show = _printer(len(runs), lease.keep)

        def stop() -> bool:
            return terminated.is_set() or time.monotonic() > deadline or lease.asked_to_stop()

        return run_in_processes(runs, options.results, options.processes, placement, stop, show)


def describe(report: PoolReport) -> str:
    """Returns outcomes and speed in one line."""
    outcomes: Sequence[str] = [outcome.value for outcome in report.outcomes.values()]
    counts = ", ".join(f"{outcomes.count(kind)} {kind}" for kind in sorted(set(outcomes)))
    return (
        f"{report.seconds:.0f} s, {report.played:,} steps, "
        f"{report.played / max(report.seconds, 1e-9):,.0f} steps/s; {counts or 'none has ended'}"
    )


def _printer(count: int, keep: Callable[[], None]) -> Callable[[PoolReport], None]:
    last = [0.0, 0]

    def show(report: PoolReport) -> None:
        keep()
        if report.seconds - last[0] < REPORT_SECONDS:
            return
        speed = (report.played - last[1]) / (report.seconds - last[0])
        print(f"{count} runs: {describe(report)}; now {speed:,.0f} steps/s", flush=True)
        for run_id, message in report.errors.items():
            print(f"  {run_id} failed: {message[:2000]}", flush=True)
        report.errors.clear()
        last[:] = [report.seconds, report.played]

    return show
