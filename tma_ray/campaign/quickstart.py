"""The first campaign of a newcomer: two teachers, three seeds each, some minutes on a laptop."""

from __future__ import annotations

from tma_ray.campaign.plan import CampaignSpec, cells_of
from tma_ray.runs import Schedule

QUICKSTART = CampaignSpec(
    name="quickstart",
    cells=cells_of(teachers=("random", "alp_gmm"), students=("ppo",)),
    seeds=(0, 1, 2),
    schedule=Schedule(
        steps=700_000, evaluation_interval=100_000, probe_interval=50_000, training_window=50_000
    ),
)
"""PPO learns to walk on Stump Tracks while ALP-GMM or Random chooses the stumps."""
