"""Campaigns as scripts, all with the same flags, and single runs without Ray."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cyclopts import App

from tma_ray.campaign.costs import confirm, estimate, long_cost
from tma_ray.campaign.failures import HeadLostError, OutageError, stop_signals
from tma_ray.campaign.options import (
    CampaignOptions,
    ExecutionOptions,
    RunOptions,
    campaign_defaults,
    chosen_campaign,
    parse_levels,
)
from tma_ray.campaign.plan import CampaignSpec, Plan, lease_holder
from tma_ray.campaign.progress import ActiveRun, ProgressView, PublishedProgress, Snapshot, View
from tma_ray.campaign.settings import Resources, Settings
from tma_ray.console import command_line
from tma_ray.console.exit_codes import FAILED, RAY_LOST, sentence
from tma_ray.console.terminal import say
from tma_ray.results import AttemptOutcome, Committer, HeartbeatWriter, Lease, Store, check_usable, start_from
from tma_ray.runs import Cell, Placement, Schedule, Status, run_locally
from tma_ray.runs.inputs import importing_plugins
from tma_ray.runs.placement import check_available
from tma_ray.support.interrupts import INTERRUPTED
from tma_ray.support.texts import counted


@dataclass(frozen=True)
class Campaign(CampaignSpec):
    """A campaign that a script starts by `main`; see `CampaignSpec` for its attributes."""

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Run the campaign as a script, with the options that all scripts share; exit with its code.

        0: all runs are done; 1: some failed, or the results could not be written any more; 2: refused before
        anything ran; 75: Ray died or was stopped, resumable; 130: stopped, resumable.

        Does nothing in a worker that imports the script for a plug-in that is defined in it.
        """
        if not importing_plugins():
            words = sys.argv[1:] if arguments is None else arguments
            raise SystemExit(command_line.run(script(self), words, self.name))


def script(campaign: CampaignSpec) -> App:
    """Return the command line of the script of a campaign."""

    def run(*, options: CampaignOptions = CampaignOptions()) -> int:
        return execute(campaign, options)

    run.__doc__ = f"Run the campaign {campaign.name!r}."
    return command_line.command(name=Path(sys.argv[0]).name, defaults=campaign_defaults(campaign))(run)


def execute(campaign: CampaignSpec, options: CampaignOptions) -> int:
    """Run what `options` choose of `campaign`; return the exit code."""
    return run_plan(chosen_campaign(campaign, options).plan(), str(options.results), options)


def run_plan(plan: Plan, results: str, options: ExecutionOptions, *, told: bool = False) -> int:
    """Print the size of `plan` and run it with the options; return the exit code, as of `Campaign.main`.

    More than an hour on this machine has to be confirmed, on a cluster beforehand (``--yes``). With `told`
    the whole cost is printed, of short plans, too.

    Raises:
        ValueError: an address that cannot be a cluster's, or over an hour that was not confirmed.
        ConnectionError: nothing listens at the address.
        Exception: errors of `execute_plan`.
    """
    settings, address = options.settings(), options.chosen_address()
    store, known = Store.open(results), None
    if options.dry_run or told:
        check_usable(store)
    nodes = options.nodes()
    if told:
        whole = estimate(plan, settings, nodes=nodes)
        known = whole.throughputs
        say(whole.describe())
    say(plan.describe())
    copy_released(store, options)
    cost = long_cost(plan, results, settings, known, nodes)
    if cost is not None and not told:
        say(f"cost: {cost.summary()}")
    if options.dry_run:
        return 0
    if cost is not None:
        confirm(plan.name, cost, yes=options.yes, address=address)
    code = executed(plan, results, settings, address)
    if not code:
        page = " -o report" if "://" in results else ""
        following = f"'tma-ray report {results}{page}' writes a page, 'tma-ray ranking {results}' a table."
        say(f"Next: {following}")
    return code


def copy_released(store: Store, options: ExecutionOptions) -> None:
    """Copy the runs of `options.start_from` to `store`, unless it is None or this is a dry run."""
    if options.start_from and not options.dry_run:
        source = Store.open(options.start_from)
        say(f"{counted(start_from(store, source), 'run')} copied from {source}")


def executed(plan: Plan, results: str, settings: Settings, address: str | None) -> int:
    """Execute `plan`; return the exit code, and say why it ended before all runs were done."""
    from tma_ray.campaign.execution import execute_plan

    try:
        ended = execute_plan(plan, results, settings, address)
    except KeyboardInterrupt:  # the second one: runs go on from the checkpoints they had
        return INTERRUPTED
    except OutageError as error:
        sys.stderr.write(f"{plan.name}: {error}\n")
        return FAILED
    except HeadLostError as error:
        sys.stderr.write(f"{plan.name}: {error}; the same command continues where it was\n")
        return RAY_LOST
    if ended.done == ended.total:
        return 0
    if ended.done + ended.failed < ended.total:
        say(f"Stopped; the same command continues where it was. 'tma-ray status {results}' shows how far.")
        return INTERRUPTED
    say(
        f"{counted(ended.failed, 'run')} failed. Next: 'tma-ray status {results}' says why, "
        f"'tma-ray rerun {results} --failed' repeats them."
    )
    return FAILED


SINGLE_RUNS = "single_runs"
"""Name of the campaign of single runs, and of the experiment of runs that belong to none."""


class SingleRunError(RuntimeError):
    """A single run failed; the cause is the error of one of its parts."""


def confirmed_single(options: RunOptions) -> tuple[Plan, Placement]:
    """Return the plan of the run of ``tma-ray run``, and its placement.

    Raises:
        ValueError: the run is impossible, or takes over an hour and was not confirmed.
    """
    (level,) = parse_levels([options.expert_knowledge])
    cell = Cell(
        environment=options.environment_name(options.environment),
        challenge=options.challenge,
        embodiment=options.embodiment,
        student=options.student,
        teacher=options.teacher,
        expert_knowledge=level,
        test_set=options.test_set,
        space=options.space or {},
    )
    plan = CampaignSpec(SINGLE_RUNS, (cell,), (options.seed,), options.schedule(Schedule())).plan()
    placement = Placement(options.device, options.threads, options.checkpoint_seconds)
    check_available(options.device)
    resources = Resources(placement.threads, gpus=float(placement.device != "cpu"))
    cost = long_cost(plan, str(options.results), Settings(resources, placement.device))
    if cost is not None:
        confirm("the run", cost, yes=options.yes)
    return plan, placement


def run_single(options: RunOptions) -> int:
    """Execute the run of ``tma-ray run``; return the exit code.

    Raises:
        ValueError: the run is impossible, or takes over an hour and was not confirmed.
    """
    plan, placement = confirmed_single(options)
    (spec,) = plan.runs
    try:
        outcome = execute_single(plan, options.results, placement, ProgressView())
    except SingleRunError as error:
        sys.stderr.write(f"{error}\n")
        say(
            f"Next: 'tma-ray logs {options.results} {spec.run_id}' has the traceback, and the same "
            f"command continues from the last checkpoint."
        )
        return FAILED
    done = outcome is AttemptOutcome.DONE
    say(f"{spec.run_id}: {outcome} in {options.results}")
    following = f"'tma-ray report {options.results}' writes a page" if done else "the same command continues"
    say(f"Next: {following}.")
    return 0 if done else INTERRUPTED


def execute_single(plan: Plan, results: str | Path, placement: Placement, view: View) -> AttemptOutcome:
    """Execute the only run of a plan in this process; return its outcome.

    Args:
        plan: plan of one run.
        results: results root.
        placement: device, threads, time between checkpoints.
        view: display of its progress.

    Raises:
        RootInUseError: another campaign is running on the root.
        SingleRunError: the run failed.
    """
    committer, (spec,) = Committer.open(results), plan.runs
    steps, holder = spec.schedule.steps, lease_holder(SINGLE_RUNS)
    progress = PublishedProgress(view, HeartbeatWriter(committer.store, holder))

    def show(status: Status) -> None:
        lease.keep()
        progress.update(Snapshot(1, 0, 0, 0, 0, 0, steps, [ActiveRun(spec.run_id, steps, status)]))

    with Lease(committer.store, holder) as lease, stop_signals() as stop:
        committer.write_cells(SINGLE_RUNS, plan.cell_rows)
        try:
            outcome = run_locally(
                spec, committer, placement, lambda: stop.is_set() or lease.asked_to_stop(), show
            )
        except Exception as error:
            progress.close(Snapshot(1, 0, 1, 0, 0, 0, steps, []))
            raise SingleRunError(
                f"{spec.run_id} failed: {type(error).__name__}: {sentence(error)}"
            ) from error
    done = outcome is AttemptOutcome.DONE
    progress.close(Snapshot(1, int(done), 0, int(not done), 0, 0, steps, []))
    return outcome
