"""What the benchmarks that train have in common."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from tma_ray.campaign import Campaign
from tma_ray.campaign.options import add_options
from tma_ray.campaign.script import execute


def main(campaign: Campaign, description: str, report: Callable[[str], None]) -> int:
    """Runs what the command line chooses of `campaign`, then reports; returns the exit code.

    Args:
        campaign: changed by the flags; only runs whose results are missing are executed.
        description: shown by ``--help``.
        report: called with the results root when all runs are done.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_options(parser, campaign)
    options = parser.parse_args()
    code = execute(campaign, options)
    if code == 0 and not options.dry_run:
        report(options.results)
    return code
