"""Functions that train runs and execute campaigns from Python; exported by `tma_ray`."""

import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import analysis
from analysis.measures.run_measures import run_measures
from tma_ray.campaign import CampaignSpec, Plan
from tma_ray.campaign.options import CampaignOptions, chosen_campaign
from tma_ray.campaign.progress import HiddenProgress, ProgressDisplay, Snapshot
from tma_ray.campaign.script import execute_single
from tma_ray.results import SINGLE_RUNS, AttemptOutcome
from tma_ray.runs import Cell, Placement, Schedule
from tma_ray.runs.checkpoints import find_policy
from tma_ray.runs.inputs import new_environment

Policy = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """Finished training run, with its scores, learning curve and policy.

    Attributes:
        run_id: id of the run.
        mastered_area: mean share of mastered test tasks over the budget, in percent.
        last_three: mean share of mastered test tasks at the last three evaluations, in percent.
        curve: columns ``step`` and ``mastered_percent``, a row for each evaluation.
        policy: function from an observation (o,) to the trained student's action (a,), without exploration.
    """

    run_id: str
    mastered_area: float
    last_three: float
    curve: pd.DataFrame
    policy: Policy


class RunsFailedError(RuntimeError):
    """Error raised if runs of a campaign failed; its `outcome` counts the runs by outcome."""

    def __init__(self, outcome: Snapshot, results: str | Path) -> None:
        super().__init__(
            f"{outcome.failed} of {outcome.total} runs failed: 'tma-ray status {results}' prints their errors"
        )
        self.outcome = outcome


def train(
    cell: Cell | None = None,
    *,
    seed: int = 0,
    schedule: Schedule | int | None = None,
    results: str | Path | None = None,
    placement: Placement | None = None,
    **names: Any,
) -> TrainedRun:
    """Train one student under one teacher in this process, and return the finished run.

    Args:
        cell: cell to run, None for the default one.
        seed: seed of the run.
        schedule: budget and intervals, or the budget alone, in environment steps, with 10 evaluations. None
            for the benchmark's.
        results: results root, where an interrupted run continues and a finished one is not repeated; None to
            keep nothing.
        placement: device, threads, time between checkpoints.
        names: fields of the cell that differ, such as ``teacher="alp_gmm"``.

    Raises:
        UnknownNameError: if a name is unknown.
        ValueError: if the cell or schedule is impossible.
        KeyboardInterrupt: if the run was stopped; with a results root the same call continues.
        tma_ray.campaign.script.SingleRunError: if the run failed.

    Examples:
        >>> import tma_ray
        >>> run = tma_ray.train(teacher="alp_gmm", student="ppo", schedule=2_000)  # doctest: +SKIP
        >>> run.mastered_area  # doctest: +SKIP
        0.0
    """
    if isinstance(schedule, int):
        interval = max(1, schedule // 10)
        schedule = replace(Schedule(), steps=schedule, evaluation_interval=interval, training_window=interval)
    cell = replace(cell or Cell(), **names)
    plan = CampaignSpec(SINGLE_RUNS, (cell,), (seed,), schedule or Schedule()).plan()
    with tempfile.TemporaryDirectory() if results is None else nullcontext(results) as root:
        return trained_run(plan, root, placement or Placement())


def trained_run(plan: Plan, results: str | Path, placement: Placement) -> TrainedRun:
    """Execute the only run of a plan, unless it is done, and return it; see `train` for errors."""
    outcome, (spec,) = execute_single(plan, results, placement, HiddenProgress()), plan.runs
    if outcome is not AttemptOutcome.DONE:
        raise KeyboardInterrupt(f"the run was {outcome}; with a results root the same call continues")
    frames = analysis.load(results)
    measures: Any = run_measures(frames).set_index("run_id").loc[spec.run_id]
    curve = frames.measured[frames.measured["run_id"] == spec.run_id]
    environment = new_environment(spec)
    spaces: Any = (environment.observation_space, environment.action_space)
    return TrainedRun(
        spec.run_id,
        float(measures["mastered_area"]),
        float(measures["last_three"]),
        curve[["step", "mastered_percent"]].sort_values("step").reset_index(drop=True),
        find_policy(spec.run_id, results).load(*spaces),
    )


def run_campaign(
    campaign: CampaignSpec,
    results: str | Path = "results",
    *,
    view: ProgressDisplay | None = None,
    **options: Any,
) -> Snapshot:
    """Execute the missing runs of a campaign on Ray, and return the number of runs by outcome.

    It neither asks for confirmation nor exits the process.

    Args:
        campaign: campaign to run.
        results: results root.
        view: display of its progress, None to show nothing.
        options: fields of `CampaignOptions`, such as ``cpus_per_run=2`` and ``address="auto"``.

    Raises:
        RunsFailedError: if some runs failed.
        KeyboardInterrupt: if it was stopped; the same call continues.
        Exception: if `tma_ray.campaign.execution.execute_plan` raises it.
    """
    from tma_ray.campaign.execution import execute_plan  # imported late, since it imports ray

    chosen = CampaignOptions(results=str(results), **options)
    plan = chosen_campaign(campaign, chosen).plan()
    outcome = execute_plan(plan, results, chosen.config(), chosen.chosen_address(), view or HiddenProgress())
    if outcome.done + outcome.failed < outcome.total:
        raise KeyboardInterrupt(f"{outcome.done} of {outcome.total} runs are done; the same call continues")
    if outcome.failed:
        raise RunsFailedError(outcome, results)
    return outcome
