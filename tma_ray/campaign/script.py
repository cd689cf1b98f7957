"""Execution of campaigns from scripts and commands, and of single runs without Ray."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cyclopts import App

from tma_ray.campaign.costs import Cost, long_cost, quote
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
from tma_ray.campaign.progress import ActiveRun, ProgressDisplay, ProgressView, PublishedProgress, Snapshot
from tma_ray.campaign.settings import ExecutionConfig, Resources
from tma_ray.console import command_line
from tma_ray.console.exit_codes import FAILED, RAY_LOST, sentence
from tma_ray.console.terminal import print_line
from tma_ray.results import (
    SINGLE_RUNS,
    AttemptOutcome,
    Committer,
    HeartbeatWriter,
    Lease,
    Store,
    check_usable,
    start_from,
)
from tma_ray.runs import Cell, Placement, Schedule, Status, run_locally
from tma_ray.runs.inputs import importing_plugins
from tma_ray.runs.placement import check_available
from tma_ray.support.interrupts import INTERRUPTED
from tma_ray.support.texts import counted


@dataclass(frozen=True)
class Campaign(CampaignSpec):
    """Campaign that a script runs from the command line by `main`; see `CampaignSpec`."""

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Run the campaign with options from the command line, and exit with a code for the outcome.

        Exit codes: 0, all runs are done; 1, some failed, or the storage did; 2, refused before anything ran;
        75, Ray died or was stopped, resumable; 130, stopped, resumable.

        It does nothing in a worker that imports the script for a plug-in.
        """
        if not importing_plugins():
            words = sys.argv[1:] if arguments is None else arguments
            raise SystemExit(command_line.run(script(self), words, self.name))


def script(campaign: CampaignSpec) -> App:
    """Return the command-line app of a campaign's script."""

    def run(*, options: CampaignOptions = CampaignOptions()) -> int:
        return execute(campaign, options)

    run.__doc__ = f"Run the campaign {campaign.name!r}."
    return command_line.command(name=Path(sys.argv[0]).name, defaults=campaign_defaults(campaign))(run)


def execute(campaign: CampaignSpec, options: CampaignOptions) -> int:
    """Run the selected part of `campaign`, and return the exit code."""
    return run_plan(chosen_campaign(campaign, options).plan(), str(options.results), options)


def run_plan(plan: Plan, results: str, options: ExecutionOptions, *, show_cost: bool = False) -> int:
    """Print the size of `plan`, run it, and return the same exit code as `Campaign.main`.

    Plans of over an hour need a confirmation on this machine, and ``--yes`` on a cluster. With `show_cost`,
    the cost of the whole plan is printed.

    Raises:
        ValueError: if the address is malformed, or a long plan was not confirmed.
        ConnectionError: if nothing listens at the address.
        Exception: if `execute_plan` raises it.
    """
    config, address, store = options.config(), options.chosen_address(), Store.open(results)
    if options.dry_run or show_cost:
        check_usable(store)
    nodes = options.nodes(config.device)
    copied = copy_released(store, options)
    whole, cost = quote(plan, results, config, nodes, whole=show_cost)
    if whole is not None:
        print_line(whole.describe())
    print_line(plan.describe())
    if copied:
        print_line(copied)
    if cost is not None and whole is None:
        print_line(f"cost: {cost.summary()}")
    if options.dry_run:
        return 0
    if cost is not None:
        confirm(plan.name, cost, yes=options.yes, address=address)
    code = execute_and_report(plan, results, config, address)
    if not code:
        page = " -o report" if "://" in results else ""
        hint = f"'tma-ray report {results}{page}' writes a page, 'tma-ray ranking {results}' a table."
        print_line(f"Next: {hint}")
    return code


def copy_released(store: Store, options: ExecutionOptions) -> str:
    """Copy the runs of `options.start_from` to `store`, except in a dry run, and return a line to print."""
    if not options.start_from or options.dry_run:
        return ""
    source = Store.open(options.start_from)
    return f"{counted(start_from(store, source), 'run')} copied from {source}"


def confirm(name: str, cost: Cost, *, yes: bool, address: str | None = None) -> None:
    """Ask in the terminal whether to start a long campaign, unless `yes` is set.

    With a cluster's `address` it does not ask: nobody watches the terminal of ``ray submit --tmux``.

    Raises:
        ValueError: if the user declines, or nobody can be asked.
    """
    if yes:
        return
    remedy = "choose a smaller budget, as with --steps 500k or --seeds 3, or pass --yes to start it"
    if address is not None or not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ValueError(f"{name} would take {cost.summary()}: {remedy}")
    if input(f"Start {name}? It takes {cost.summary()}. [y/N] ").strip().lower() not in ("y", "yes"):
        raise ValueError(f"not started; {remedy}")


def execute_and_report(plan: Plan, results: str, config: ExecutionConfig, address: str | None) -> int:
    """Execute `plan`, print the reason if it ends early, and return the exit code."""
    from tma_ray.campaign.execution import execute_plan  # imported late, since it imports ray

    try:
        outcome = execute_plan(plan, results, config, address)
    except KeyboardInterrupt:  # the second Ctrl-C: runs will continue from their previous checkpoints
        return INTERRUPTED
    except OutageError as error:
        sys.stderr.write(f"{plan.name}: {error}\n")
        return FAILED
    except HeadLostError as error:
        sys.stderr.write(f"{plan.name}: {error}; the same command continues where it was\n")
        return RAY_LOST
    if outcome.done == outcome.total:
        return 0
    if outcome.done + outcome.failed < outcome.total:
        print_line(
            f"Stopped; the same command continues where it was. 'tma-ray status {results}' shows how far."
        )
        return INTERRUPTED
    print_line(
        f"{counted(outcome.failed, 'run')} failed. Next: 'tma-ray status {results}' says why, "
        f"'tma-ray rerun {results} --failed' repeats them."
    )
    return FAILED


class SingleRunError(RuntimeError):
    """Error raised if a single run fails; ``__cause__`` is the run's exception."""


def confirmed_single(options: RunOptions) -> tuple[Plan, Placement]:
    """Return the plan and placement of ``tma-ray run``, asking for confirmation of a long run.

    Raises:
        ValueError: if the run is impossible, or long and not confirmed.
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
    cost = long_cost(plan, str(options.results), ExecutionConfig(resources, placement.device))
    if cost is not None:
        confirm("the run", cost, yes=options.yes)
    return plan, placement


def run_single(options: RunOptions) -> int:
    """Execute the run of the command ``tma-ray run``, and return the exit code.

    Raises:
        ValueError: if the run is impossible, or long and not confirmed.
    """
    plan, placement = confirmed_single(options)
    (spec,) = plan.runs
    try:
        outcome = execute_single(plan, options.results, placement, ProgressView())
    except SingleRunError as error:
        sys.stderr.write(f"{error}\n")
        print_line(
            f"Next: 'tma-ray logs {options.results} {spec.run_id}' has the traceback, and the same "
            f"command continues from the last checkpoint."
        )
        return FAILED
    done = outcome is AttemptOutcome.DONE
    print_line(f"{spec.run_id}: {outcome} in {options.results}")
    hint = f"'tma-ray report {options.results}' writes a page" if done else "the same command continues"
    print_line(f"Next: {hint}.")
    return 0 if done else INTERRUPTED


def execute_single(
    plan: Plan, results: str | Path, placement: Placement, view: ProgressDisplay
) -> AttemptOutcome:
    """Execute the only run of a plan in this process, and return its outcome.

    Args:
        plan: plan of one run.
        results: results root.
        placement: device, threads, time between checkpoints.
        view: display of its progress.

    Raises:
        RootInUseError: if another campaign is running on the root.
        SingleRunError: if the run failed.
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
