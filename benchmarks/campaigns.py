"""Command line of benchmarks that are campaigns."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from tma_ray.campaign import Campaign
from tma_ray.campaign.options import CampaignOptions, campaign_defaults
from tma_ray.campaign.script import execute
from tma_ray.console import command_line


def main(campaign: Campaign, description: str, report: Callable[[str], None]) -> int:
    """Run a campaign with the options of the command line, then report; return the exit code.

    Args:
        campaign: the default; only runs whose results are missing are executed.
        description: text for ``--help``.
        report: called with the results root once all runs are done.
    """

    def run(*, options: CampaignOptions = CampaignOptions()) -> int:
        code = execute(campaign, options)
        if code == 0 and not options.dry_run:
            report(str(options.results))
        return code

    run.__doc__ = description
    command = command_line.command(name=Path(sys.argv[0]).name, defaults=campaign_defaults(campaign))
    return command_line.run(command(run), sys.argv[1:], campaign.name)
