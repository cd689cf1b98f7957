"""Learning curves of SAC, in cohorts or alone, without Ray; an interrupted call is continued by the next.

    python benchmarks/sac_learning.py --parts easy,original --seeds 5 --device cuda --cohort 32 --compiled \
        --processes 28 --minutes 9 --results build/sac_learning

Part "easy": Random on the easy task space, 1.5 million steps, in both variants of the log deviation. Part
"original": Random and ALP-GMM on the original space, 3 million steps. Prints every seed's mastered share and
mean return by step; writes them to ``curves.json`` in the results root.
"""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
from pools import execute, parser

from tma_ray.campaign.plan import CampaignSpec, Plan, joined_plan
from tma_ray.results import Results, Table
from tma_ray.runs import Cell, Schedule
from tma_ray.tasks import MASTERY_RETURN

CLAMP = "sac:log_std=clamp"
"""Variant of the log deviation in stable-baselines3."""


def plan(parts: tuple[str, ...], seeds: int, precision: str) -> Plan:
    """Return the plan of `parts`, with the first `seeds` of every cell."""
    hyper = {} if precision == "highest" else {"matmul_precision": precision}
    campaigns = {
        "easy": CampaignSpec(
            "sac_easy",
            tuple(
                Cell(challenge="easy", student=student, student_hyperparameters=hyper)
                for student in ("sac", CLAMP)
            ),
            tuple(range(seeds)),
            Schedule(1_500_000, 100_000, 500_000, training_window=100_000),
        ),
        "original": CampaignSpec(
            "sac_original",
            tuple(
                Cell(student="sac", teacher=teacher, student_hyperparameters=hyper)
                for teacher in ("random", "alp_gmm")
            ),
            tuple(range(seeds)),
            Schedule(3_000_000, 250_000, 250_000, training_window=100_000),
        ),
    }
    return joined_plan("sac_learning", [campaigns[part] for part in parts])


def curves(root: str) -> pd.DataFrame:
    """Return mastered % and mean return by seed and evaluation."""
    results = Results.open(root)
    rows = results.table(Table.EVALUATIONS).to_pandas()
    rows["mastered"] = 100.0 * (rows.episodic_return > MASTERY_RETURN)
    means = rows.groupby(["run_id", "step"], observed=True)[["episodic_return", "mastered"]].mean()
    names = ["run_id", "challenge", "embodiment", "teacher", "student", "seed"]
    runs = results.table(Table.CELLS).to_pandas()[names].drop_duplicates("run_id")
    joined: pd.DataFrame = means.reset_index().merge(runs, on="run_id")
    return joined


def main() -> int:
    """Execute missing runs, and print all learning curves."""
    options = parser(str(__doc__))
    options.add_argument("--parts", default="easy,original", help="easy, original or both")
    options.add_argument("--seeds", type=int, default=5, help="of every cell")
    options.add_argument("--precision", default="highest", help="of the products: highest, high or medium")
    given = options.parse_args()
    execute(plan(tuple(given.parts.split(",")), given.seeds, given.precision), given)
    table = curves(given.results)
    for name, cell in table.groupby(["challenge", "teacher", "student"], observed=True):
        print(*name)
        print(cell.pivot(index="step", columns="seed", values="mastered").round(0).to_string())
        print(cell.pivot(index="step", columns="seed", values="episodic_return").round(0).to_string())
    content = table.round(2).to_dict(orient="list")
    Path(given.results, "curves.json").write_text(json.dumps(content))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
