"""Runs and campaigns as functions: for notebooks, services and searches."""

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
from tma_ray.campaign.progress import Snapshot, Unseen, View
from tma_ray.campaign.script import SINGLE_RUNS, execute_single
from tma_ray.envs import make_environment
from tma_ray.results import AttemptOutcome
from tma_ray.runs import Cell, Placement, Schedule
from tma_ray.runs.inputs import arguments
from tma_ray.runs.saved_policies import find_policy

Policy = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A run that is done.

    Attributes:
        run_id: id of the run.
        mastered_area: the headline, mean share of mastered test tasks over the budget, in percent.
        last_three: mean share of mastered test tasks at the last three evaluations, in percent.
        curve: columns ``step`` and ``mastered_percent``, a row for each evaluation.
        policy: function from an observation (o,) to the action (a,) of the trained student, without
            exploration.
    """

    run_id: str
    mastered_area: float
    last_three: float
    curve: pd.DataFrame
    policy: Policy


class RunsFailedError(RuntimeError):
    """Some runs of a campaign failed; the message has their number, `outcome` the others."""

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
    """Train one student under one teacher in this process, and return what came of it.

    Args:
        cell: the cell, None for the default one.
        seed: seed of the run.
        schedule: budget and intervals, or the budget alone, in environment steps; then there are 10
            evaluations. None for the benchmark's.
        results: results root, in which an interrupted run is continued and one that is done is not repeated;
            None to keep nothing.
        placement: device, threads, time between checkpoints.
        names: fields of the cell that differ, such as ``teacher="alp_gmm"``.

    Raises:
        UnknownNameError: no such part.
        ValueError: an impossible cell or schedule.
        KeyboardInterrupt: the run was stopped; with a results root the same call continues.
        tma_ray.campaign.script.SingleRunError: the run failed.

    Examples:
        >>> import tma_ray
        >>> run = tma_ray.train(teacher="alp_gmm", student="ppo", schedule=2_000)  # doctest: +SKIP
        >>> run.mastered_area  # doctest: +SKIP
        0.0
    """
    if isinstance(schedule, int):
        interval = max(1, schedule // 10)
        schedule = replace(Schedule(), steps=schedule, evaluation_interval=interval, training_window=interval)
    chosen = replace(cell or Cell(), **names)
    plan = CampaignSpec(SINGLE_RUNS, (chosen,), (seed,), schedule or Schedule()).plan()
    with tempfile.TemporaryDirectory() if results is None else nullcontext(results) as root:
        return trained_run(plan, root, placement or Placement())


def trained_run(plan: Plan, results: str | Path, placement: Placement) -> TrainedRun:
    """Return the only run of a plan, executed here if the results root lacks it; errors as of `train`."""
    outcome, (spec,) = execute_single(plan, results, placement, Unseen()), plan.runs
    if outcome is not AttemptOutcome.DONE:
        raise KeyboardInterrupt(f"the run was {outcome}; with a results root the same call continues")
    frames = analysis.load(results)
    measures: Any = run_measures(frames).set_index("run_id").loc[spec.run_id]
    curve = frames.measured[frames.measured["run_id"] == spec.run_id]
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    spaces: Any = (environment.observation_space, environment.action_space)
    return TrainedRun(
        spec.run_id,
        float(measures["mastered_area"]),
        float(measures["last_three"]),
        curve[["step", "mastered_percent"]].sort_values("step").reset_index(drop=True),
        find_policy(spec.run_id, results).load(*spaces),
    )


def run_campaign(
    campaign: CampaignSpec, results: str | Path = "results", *, view: View | None = None, **options: Any
) -> Snapshot:
    """Run what a campaign lacks on Ray, and return the numbers of runs by outcome.

    Nothing is confirmed, and the process never exits.

    Args:
        campaign: the campaign.
        results: results root.
        view: display of its progress, None for none.
        options: fields of `CampaignOptions`, such as ``cpus_per_run=2`` and ``address="auto"``.

    Raises:
        RunsFailedError: some runs failed.
        KeyboardInterrupt: it was stopped; the same call continues.
        Exception: errors of `tma_ray.campaign.execution.execute_plan`.
    """
    from tma_ray.campaign.execution import execute_plan  # deferred: ray

    chosen = CampaignOptions(results=str(results), **options)
    plan = chosen_campaign(campaign, chosen).plan()
    ended = execute_plan(plan, results, chosen.settings(), chosen.chosen_address(), view or Unseen())
    if ended.done + ended.failed < ended.total:
        raise KeyboardInterrupt(f"{ended.done} of {ended.total} runs are done; the same call continues")
    if ended.failed:
        raise RunsFailedError(ended, results)
    return ended
