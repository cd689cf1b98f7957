"""Runs of lite-1, lite-2 and long-1 in processes of one machine, alone or in cohorts, without Ray.

    python benchmarks/lite.py --stage core --processes 16 --minutes 9 --results lite
    python benchmarks/lite.py --experiment long_1 --processes 2 --minutes 170 --results long --grow kept
    python benchmarks/lite.py --stage core --device cuda --cohort 32 --processes 32 --results lite

Executes runs in the order of the experiment's script. Either script can continue the other's runs.
"""

from __future__ import annotations

from pools import execute, parser

from tma_ray.benchmark import Experiment, find_experiment
from tma_ray.campaign.plan import Plan, joined_plan, matrix_campaigns
from tma_ray.runs import Schedule


def plan(experiment: Experiment, stage: str | None) -> Plan:
    """Return the plan of a stage of an experiment, or of all stages."""
    size = experiment.size
    intervals = size.evaluation_interval, size.probe_interval, size.training_window
    assert all(intervals), "a release has intervals of its own"
    evaluation, probe, window = (interval or 0 for interval in intervals)
    schedule = Schedule(evaluation_interval=evaluation, probe_interval=probe, training_window=window)
    matrices = [matrix.taught_by(experiment.teachers) for matrix in experiment.stage(stage)]
    campaigns = matrix_campaigns(matrices, schedule=schedule)
    return joined_plan("_".join(filter(None, (experiment.name, stage))), campaigns)


def main() -> int:
    """Execute the runs that are missing."""
    options = parser(str(__doc__))
    options.add_argument("--experiment", default="lite_2", choices=("lite_1", "lite_2", "long_1"))
    options.add_argument("--stage", help="stage of the experiment; all of them by default")
    given = options.parse_args()
    execute(plan(find_experiment(given.experiment), given.stage), given)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
