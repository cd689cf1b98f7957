"""Campaigns, whose cells become runs and whose runs become Ray actors; no other package uses Ray.

What is listed here is imported when it is first asked for: looking at a root needs none of it.
"""

from typing import TYPE_CHECKING

from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from tma_ray.campaign.plan import (
        CampaignSpec,
        Plan,
        cells_of,
        joined_plan,
        matrix_campaigns,
        matrix_cells,
    )
    from tma_ray.campaign.script import Campaign

__all__ = ["Campaign", "CampaignSpec", "Plan", "cells_of", "joined_plan", "matrix_campaigns", "matrix_cells"]

__getattr__, __dir__ = attach(__name__, __file__)
