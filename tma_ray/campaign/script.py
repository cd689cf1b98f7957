"""A campaign as a script: the same flags for all of them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rich.console import Console

from tma_ray.campaign.failures.outages import OutageError
from tma_ray.campaign.monitor.progress import Snapshot
from tma_ray.campaign.options import add_options, chosen_address, chosen_campaign, chosen_settings
from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.results import RootInUseError

EXIT_FAILED = 1
EXIT_REFUSED = 2
EXIT_STOPPED = 130


def main(campaign: CampaignSpec, arguments: Sequence[str] | None = None) -> int:
    """Runs `campaign` as the command line says; returns the exit code.

    0: all runs are done; 1: some failed, or the results could not be written any more; 2: refused before
    anything ran; 130: stopped, resumable.
    """
    parser = argparse.ArgumentParser(description=f"Runs the campaign {campaign.name!r}.")
    add_options(parser)
    return execute(campaign, parser.parse_args(arguments))


def execute(campaign: CampaignSpec, options: argparse.Namespace) -> int:
    """Runs what `options` choose of `campaign`; returns the exit code as `main`."""
    try:
        plan = chosen_campaign(campaign, options).plan()
        return run_plan(plan, options.results, options)
    except (ValueError, ConnectionError, RootInUseError) as error:
        sys.stderr.write(f"{campaign.name}: {error}\n")
        return EXIT_REFUSED


def run_plan(plan: Plan, results: str, options: argparse.Namespace) -> int:
    """Says what `plan` comes to and runs it as the flags for execution say; returns the exit code as `main`.

    Raises:
        Exception: what `execute_plan` raises.
    """
    from tma_ray.campaign.execution import execute_plan

    console, settings = Console(), chosen_settings(options)
    console.print(plan.describe(), highlight=False, soft_wrap=True)
    if options.dry_run:
        return 0
    try:
        ended = execute_plan(plan, results, settings, chosen_address(options))
    except KeyboardInterrupt:  # the second one: runs go on from the checkpoints they had
        return EXIT_STOPPED
    except OutageError as error:
        sys.stderr.write(f"{plan.name}: {error}\n")
        return EXIT_FAILED
    return _conclude(ended, results, console)


def _conclude(ended: Snapshot, results: str, console: Console) -> int:
    if ended.done == ended.total:
        return 0
    if ended.done + ended.failed < ended.total:
        console.print("Stopped; the same command continues where it was.", highlight=False)
        return EXIT_STOPPED
    console.print(f"{ended.failed} runs failed; 'tma-ray status {results}' says why.", highlight=False)
    return EXIT_FAILED
