"""One run in this process: no Ray, the same files."""

from __future__ import annotations

import argparse
from dataclasses import fields

from rich.console import Console

from tma_ray.campaign.failures.stopping import StopSignals
from tma_ray.campaign.monitor.progress import ActiveRun, ProgressView, PublishedProgress, Snapshot
from tma_ray.campaign.options import parse_levels
from tma_ray.campaign.plan import CampaignSpec, lease_holder
from tma_ray.campaign.script import EXIT_STOPPED
from tma_ray.results import AttemptOutcome, Committer, HeartbeatWriter, Lease
from tma_ray.runs import Cell, Placement, Schedule, Status, run_locally

CAMPAIGN = "single_runs"


def run_single(options: argparse.Namespace) -> int:
    """Runs what the flags of ``tma-ray run`` name; returns the exit code.

    Raises:
        ValueError: what cannot run.
    """
    (level,) = parse_levels([options.expert_knowledge])
    cell = Cell(
        environment=options.environment,
        challenge=options.challenge,
        embodiment=options.embodiment,
        student=options.student,
        teacher=options.teacher,
        expert_knowledge=level,
        test_set=options.test_set,
    )
    given = {field.name: getattr(options, field.name, None) for field in fields(Schedule)}
    schedule = Schedule(**{name: value for name, value in given.items() if value is not None})
    plan = CampaignSpec(CAMPAIGN, (cell,), (options.seed,), schedule).plan()
    committer = Committer.open(options.results)
    (spec,) = plan.runs
    console, holder = Console(), lease_holder(CAMPAIGN)
    view = PublishedProgress(ProgressView(), HeartbeatWriter(committer.store, holder))

    def show(status: Status) -> None:
        lease.keep()
        view.update(
            Snapshot(1, 0, 0, 0, 0, 0, schedule.steps, [ActiveRun(spec.run_id, schedule.steps, status)])
        )

    placement = Placement(options.device, options.threads, options.checkpoint_seconds)
    with Lease(committer.store, holder) as lease, StopSignals() as signals:
        committer.write_cells(CAMPAIGN, plan.cell_rows)
        outcome = run_locally(
            spec, committer, placement, lambda: signals.requested or lease.asked_to_stop(), show
        )
    done = outcome is AttemptOutcome.DONE
    view.close(Snapshot(1, int(done), 0, int(not done), 0, 0, schedule.steps, []))
    console.print(f"{spec.run_id}: {outcome} in {options.results}", highlight=False, soft_wrap=True)
    return 0 if done else EXIT_STOPPED
