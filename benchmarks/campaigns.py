"""Command line of the benchmarks that are campaigns."""

from __future__ import annotations

from collections.abc import Callable

from tma_ray.campaign import Campaign
from tma_ray.campaign.options import add_options
from tma_ray.campaign.script import execute
from tma_ray.command_line import Parser


def main(campaign: Campaign, description: str, report: Callable[[str], None]) -> int:
    """Runs `campaign` as the command line changes it, then reports; returns the exit code.

    Args:
        campaign: the default; only runs whose results are missing are executed.
        description: text for ``--help``.
        report: called with the results root once all runs are done.
    """
    parser = Parser(description=description)
    add_options(parser, campaign)
    options = parser.parse_args()
    code = execute(campaign, options)
    if code == 0 and not options.dry_run:
        report(options.results)
    return code
