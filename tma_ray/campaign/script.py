"""Campaigns as scripts, all with the same flags."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cyclopts import App

from tma_ray import command_line
from tma_ray.campaign.costs import confirm, estimate, long_cost, terminal_question
from tma_ray.campaign.failures import HeadLostError, OutageError
from tma_ray.campaign.options import (
    CampaignOptions,
    ExecutionOptions,
    campaign_defaults,
    chosen_address,
    chosen_campaign,
    chosen_nodes,
    chosen_settings,
)
from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.campaign.settings import Settings
from tma_ray.commands.exits import FAILED, RAY_LOST
from tma_ray.commands.interrupts import INTERRUPTED
from tma_ray.commands.texts import counted
from tma_ray.results import Store, check_usable, start_from
from tma_ray.runs.inputs import importing_plugins
from tma_ray.terminal import terminal


@dataclass(frozen=True)
class Campaign(CampaignSpec):
    """A campaign that a script starts by `main`; see `CampaignSpec` for its attributes."""

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Run the campaign as a script, with the options that all scripts share; exit with its code.

        Does nothing in a worker that imports the script for a plug-in that is defined in it.
        """
        if not importing_plugins():
            raise SystemExit(main(self, arguments))


def main(campaign: CampaignSpec, arguments: Sequence[str] | None = None) -> int:
    """Run `campaign` as the command line says; return the exit code.

    0: all runs are done; 1: some failed, or the results could not be written any more; 2: refused before
    anything ran; 75: Ray died or was stopped, resumable; 130: stopped, resumable.
    """
    words = sys.argv[1:] if arguments is None else arguments
    return command_line.run(script(campaign), words, campaign.name)


def script(campaign: CampaignSpec) -> App:
    """Return the command line of the script of a campaign."""

    def run(*, options: CampaignOptions = CampaignOptions()) -> int:
        return execute(campaign, options)

    run.__doc__ = f"Run the campaign {campaign.name!r}."
    return command_line.command(name=Path(sys.argv[0]).name, defaults=campaign_defaults(campaign))(run)


def execute(campaign: CampaignSpec, options: CampaignOptions) -> int:
    """Run what `options` choose of `campaign`; return the exit code as `main`."""
    return run_plan(chosen_campaign(campaign, options).plan(), str(options.results), options)


def run_plan(plan: Plan, results: str, options: ExecutionOptions, *, told: bool = False) -> int:
    """Print the size of `plan` and run it with the options for execution; return the exit code, as `main`.

    More than an hour on this machine has to be confirmed, on a cluster beforehand (``--yes``).

    Args:
        plan: runs to execute.
        results: results root to write to.
        options: options for execution.
        told: True to print the whole cost, of short plans, too.

    Raises:
        ValueError: an address that cannot be a cluster's, or over an hour that was not confirmed.
        ConnectionError: nothing listens at the address.
        Exception: errors of `execute_plan`.
    """
    console, settings, address = terminal(), chosen_settings(options), chosen_address(options)
    store, known = Store.open(results), None
    if options.dry_run or told:
        check_usable(store)
    nodes = chosen_nodes(options)
    if told:
        whole = estimate(plan, settings, nodes=nodes)
        known = whole.throughputs
        console.print(whole.describe(), highlight=False, soft_wrap=True)
    console.print(plan.describe(), highlight=False, soft_wrap=True)
    if options.start_from and not options.dry_run:
        source = Store.open(options.start_from)
        console.print(f"{counted(start_from(store, source), 'run')} copied from {source}", highlight=False)
    cost = long_cost(plan, results, settings, known, nodes)
    if cost is not None and not told:
        console.print(f"cost: {cost.summary()}", highlight=False, soft_wrap=True)
    if options.dry_run:
        return 0
    if cost is not None:
        confirm(plan.name, cost, yes=options.yes, ask=terminal_question(address))
    code, sentence = executed(plan, results, settings, address)
    if sentence:
        console.print(sentence, highlight=False, soft_wrap=True)
    return code


def executed(plan: Plan, results: str, settings: Settings, address: str | None) -> tuple[int, str]:
    """Execute `plan`; return the exit code, and a sentence on the end and the next command, empty if told."""
    from tma_ray.campaign.execution import execute_plan

    try:
        ended = execute_plan(plan, results, settings, address)
    except KeyboardInterrupt:  # the second one: runs go on from the checkpoints they had
        return INTERRUPTED, ""
    except OutageError as error:
        sys.stderr.write(f"{plan.name}: {error}\n")
        return FAILED, ""
    except HeadLostError as error:
        sys.stderr.write(f"{plan.name}: {error}; the same command continues where it was\n")
        return RAY_LOST, ""
    if ended.done == ended.total:
        page = " -o report" if "://" in results else ""
        return 0, (
            f"Next: 'tma-ray report {results}{page}' writes a page, 'tma-ray ranking {results}' a table."
        )
    if ended.done + ended.failed < ended.total:
        return INTERRUPTED, (
            f"Stopped; the same command continues where it was. 'tma-ray status {results}' shows how far."
        )
    return FAILED, (
        f"{counted(ended.failed, 'run')} failed. Next: 'tma-ray status {results}' says why, "
        f"'tma-ray rerun {results} --failed' repeats them."
    )
