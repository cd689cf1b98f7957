"""Learning curve of PPO under Random on the easy task space of Stump Tracks, as a campaign.

    python benchmarks/learning.py --seeds 5 --steps 2M --results build/learning

Prints return and mastered share of every seed at every evaluation. For comparison, the original Box2D
environment with the same PPO: 245 and 85 % at 1 million steps, 275 and 95 % at 2 million.
"""

from __future__ import annotations

from campaigns import main

from tma_ray.campaign import Campaign, cells_of
from tma_ray.results import Results, Table
from tma_ray.runs import Schedule
from tma_ray.tasks import MASTERY_RETURN

CAMPAIGN = Campaign(
    name="learning",
    cells=cells_of(teachers=("random",), students=("ppo",), challenges=("easy",)),
    seeds=tuple(range(5)),
    schedule=Schedule(steps=2_000_000),
)

WALKS_RETURN, WALKS_SHARE = 230.0, 0.7


def summarise(root: str) -> None:
    """Print the evaluations of every run, and the number of seeds that walk."""
    rows = Results.open(root).table(Table.EVALUATIONS).to_pandas()
    rows["mastered"] = rows.episodic_return > MASTERY_RETURN
    curves = rows.groupby(["run_id", "step"], observed=True).agg(
        mean_return=("episodic_return", "mean"), mastered=("mastered", "mean"), length=("length", "mean")
    )
    print(curves.round(2).to_string())
    last = curves.groupby("run_id", observed=True).tail(1)
    walking = ((last.mean_return > WALKS_RETURN) & (last.mastered > WALKS_SHARE)).sum()
    print(
        f"{walking} of {len(last)} seeds walk: mean return over {WALKS_RETURN:g} "
        f"and over {WALKS_SHARE:.0%} of the tasks mastered"
    )


if __name__ == "__main__":
    raise SystemExit(main(CAMPAIGN, str(__doc__), summarise))
