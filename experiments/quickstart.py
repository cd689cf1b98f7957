"""Two teachers, three seeds each: a first campaign of a few minutes on a laptop.

    python experiments/quickstart.py --results results

PPO learns to walk on Stump Tracks while ALP-GMM or Random chooses the stumps.
"""

from tma_ray.campaign import Campaign, cells_of
from tma_ray.runs import Schedule

CAMPAIGN = Campaign(
    name="quickstart",
    cells=cells_of(teachers=("random", "alp_gmm"), students=("ppo",)),
    seeds=(0, 1, 2),
    schedule=Schedule(
        steps=700_000, evaluation_interval=100_000, probe_interval=50_000, training_window=50_000
    ),
)

if __name__ == "__main__":
    CAMPAIGN.main()
