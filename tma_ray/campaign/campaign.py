"""Campaigns that run as scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.script import main
from tma_ray.runs.inputs import importing_plugins


@dataclass(frozen=True)
class Campaign(CampaignSpec):
    """A campaign that a script starts by `main`; see `CampaignSpec` for its attributes."""

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Runs the campaign as a script, with the flags that all scripts share; exits with its code.

        Does nothing in a worker that imports the script for a plug-in that is defined in it.
        """
        if importing_plugins():
            return
        raise SystemExit(main(self, arguments))
