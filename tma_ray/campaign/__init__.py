"""Campaigns: cells become runs, and runs become actors on a Ray cluster. The only user of Ray."""

from tma_ray.campaign.campaign import Campaign, Plan, cells_of

__all__ = ["Campaign", "Plan", "cells_of"]
