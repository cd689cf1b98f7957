"""Planning, scheduling and execution of campaigns with Ray; no other package uses Ray.

Names are imported on first use, since reading a results root needs none of them.
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
