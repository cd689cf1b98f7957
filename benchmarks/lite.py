"""Runs of the release lite-1 in processes of one machine, alone or in cohorts, without Ray.

    python benchmarks/lite.py --stage core --processes 16 --minutes 9 --results lite
    python benchmarks/lite.py --stage core --device cuda --cohort 32 --processes 32 --results lite

Takes the runs in the order of ``experiments/lite_1.py``; each continues what the other leaves.
"""

from __future__ import annotations

from pools import execute, parser

from tma_ray.benchmark.experiments import LITE_1_SIZE, LITE_1_STAGES, LITE_1_TEACHERS
from tma_ray.campaign.plan import Plan, joined_plan, matrix_campaigns
from tma_ray.runs import Schedule


def plan(stage: str) -> Plan:
    """Return the runs of `stage`."""
    intervals = LITE_1_SIZE.evaluation_interval, LITE_1_SIZE.probe_interval, LITE_1_SIZE.training_window
    assert all(intervals), "lite-1 has intervals of its own"
    evaluation, probe, window = (interval or 0 for interval in intervals)
    schedule = Schedule(evaluation_interval=evaluation, probe_interval=probe, training_window=window)
    matrices = [matrix.taught_by(LITE_1_TEACHERS) for matrix in LITE_1_STAGES[stage]]
    campaigns = matrix_campaigns(matrices, schedule=schedule)
    return joined_plan(f"lite_1_{stage}", campaigns)


def main() -> int:
    """Run what is missing."""
    options = parser(str(__doc__))
    options.add_argument("--stage", default="core", choices=sorted(LITE_1_STAGES))
    given = options.parse_args()
    execute(plan(given.stage), given)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
