"""Campaigns: cells become runs, and runs become actors on a Ray cluster. The only user of Ray."""

from tma_ray.campaign.campaign import Campaign, Plan, cells_of
from tma_ray.campaign.experiments import run_experiment
from tma_ray.campaign.matrices import joined_plan, matrix_campaigns, matrix_cells

__all__ = [
    "Campaign",
    "Plan",
    "cells_of",
    "joined_plan",
    "matrix_campaigns",
    "matrix_cells",
    "run_experiment",
]
