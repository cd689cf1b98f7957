"""Campaigns: cells become runs, and runs become actors on a Ray cluster. The only user of Ray."""

from tma_ray.campaign.campaign import Campaign
from tma_ray.campaign.matrices import joined_plan, matrix_campaigns, matrix_cells
from tma_ray.campaign.plan import CampaignSpec, Plan, cells_of

__all__ = [
    "Campaign",
    "CampaignSpec",
    "Plan",
    "cells_of",
    "joined_plan",
    "matrix_campaigns",
    "matrix_cells",
]
