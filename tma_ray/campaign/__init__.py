"""Campaigns: cells become runs, and runs become actors on a Ray cluster. The only user of Ray.

What is listed here is imported when it is first asked for: looking at a root needs none of it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_MODULES = {
    "Campaign": "campaign",
    "CampaignSpec": "plan",
    "Plan": "plan",
    "cells_of": "plan",
    "joined_plan": "matrices",
    "matrix_campaigns": "matrices",
    "matrix_cells": "matrices",
}


def __getattr__(name: str) -> Any:
    """Imports the module of a name when it is first asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
