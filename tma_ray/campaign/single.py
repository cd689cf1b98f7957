"""One run in this process: no Ray, the same files."""

from __future__ import annotations

from tma_ray.campaign.costs import confirm, long_cost, terminal_question
from tma_ray.campaign.failures import StopSignals
from tma_ray.campaign.options import RunOptions, environment_name, parse_levels, replace_schedule
from tma_ray.campaign.plan import CampaignSpec, lease_holder
from tma_ray.campaign.progress import ActiveRun, ProgressView, PublishedProgress, Snapshot
from tma_ray.campaign.settings import Resources, Settings
from tma_ray.commands.interrupts import INTERRUPTED
from tma_ray.results import AttemptOutcome, Committer, HeartbeatWriter, Lease
from tma_ray.runs import Cell, Placement, Schedule, Status, run_locally
from tma_ray.runs.placement import check_available
from tma_ray.terminal import terminal

CAMPAIGN = "single_runs"


def run_single(options: RunOptions) -> int:
    """Execute the run of ``tma-ray run``; return the exit code.

    Raises:
        ValueError: the run is impossible, or takes over an hour and was not confirmed.
    """
    (level,) = parse_levels([options.expert_knowledge])
    cell = Cell(
        environment=environment_name(options.environment, options),
        challenge=options.challenge,
        embodiment=options.embodiment,
        student=options.student,
        teacher=options.teacher,
        expert_knowledge=level,
        test_set=options.test_set,
        space=options.space or {},
    )
    schedule = replace_schedule(Schedule(), options)
    plan = CampaignSpec(CAMPAIGN, (cell,), (options.seed,), schedule).plan()
    placement = Placement(options.device, options.threads, options.checkpoint_seconds)
    check_available(options.device)
    resources = Resources(placement.threads, gpus=float(placement.device != "cpu"))
    cost = long_cost(plan, str(options.results), Settings(resources, placement.device))
    if cost is not None:
        confirm("the run", cost, yes=options.yes, ask=terminal_question())
    committer = Committer.open(options.results)
    (spec,) = plan.runs
    console, holder = terminal(), lease_holder(CAMPAIGN)
    view = PublishedProgress(ProgressView(), HeartbeatWriter(committer.store, holder))

    def show(status: Status) -> None:
        lease.keep()
        view.update(
            Snapshot(1, 0, 0, 0, 0, 0, schedule.steps, [ActiveRun(spec.run_id, schedule.steps, status)])
        )

    with Lease(committer.store, holder) as lease, StopSignals() as signals:
        committer.write_cells(CAMPAIGN, plan.cell_rows)
        outcome = run_locally(
            spec, committer, placement, lambda: signals.requested or lease.asked_to_stop(), show
        )
    done = outcome is AttemptOutcome.DONE
    view.close(Snapshot(1, int(done), 0, int(not done), 0, 0, schedule.steps, []))
    console.print(f"{spec.run_id}: {outcome} in {options.results}", highlight=False, soft_wrap=True)
    following = f"'tma-ray report {options.results}' writes a page" if done else "the same command continues"
    console.print(f"Next: {following}.", highlight=False, soft_wrap=True)
    return 0 if done else INTERRUPTED
