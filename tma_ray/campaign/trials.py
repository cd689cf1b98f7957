"""Execution of a trial's interim looks, within a budget."""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cached_property
from threading import Timer

from tma_ray.campaign.costs import Cost, estimate, unfinished
from tma_ray.campaign.options import TrialOptions
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.script import execute_and_report
from tma_ray.campaign.settings import Nodes
from tma_ray.campaign.simulated import SimulatedRoot
from tma_ray.console.terminal import print_line
from tma_ray.results import NotRunningError, Store, ask_to_stop
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import EPISODES, find_simulated_challenge, matrix

Judge = Callable[[], bool]  # evaluates the interim looks so far; returns True to end the trial


def campaign_of(teacher: str) -> str:
    """Return the name of a trial's campaign, unique per teacher since a release may have several trials."""
    return f"trial_{re.sub('[^0-9a-z]+', '_', teacher.lower()).strip('_')}"


class TrialRuns:
    """Runs of a trial and the options of their execution.

    Args:
        plans: runs up to each look, including those of earlier looks.
        options: options of the trial.
    """

    def __init__(self, plans: Sequence[Plan], options: TrialOptions) -> None:
        self.plans, self._options = plans, options
        self.results, self.config = str(options.results), options.config()
        self.address, self.budget = options.chosen_address(), options.budget

    @cached_property
    def nodes(self) -> Nodes | None:
        """Nodes of the cluster, or None for this machine."""
        return self._options.nodes(self.config.device)

    def remaining(self) -> list[Plan]:
        """Return, for each interim look, the plan of the unfinished runs up to that look.

        Raises:
            ResultsRootError: if the results root belongs to something else.
        """
        return [unfinished(plan, self.results) for plan in self.plans]

    def cost(self) -> Cost | None:
        """Return the cost of all unfinished runs, or None if nothing is left."""
        left = self.remaining()[-1]
        return estimate(left, self.config, nodes=self.nodes) if left.runs else None

    def hours(self, plan: Plan, cost: Cost | None) -> float:
        """Return the estimated time of a plan in hours, at the speeds in `cost`."""
        speeds = cost.throughputs if cost else None
        return estimate(plan, self.config, speeds, nodes=self.nodes).wall_hours if plan.runs else 0.0


def affordable_look(trial: TrialRuns, cost: Cost | None) -> int | None:
    """Return the index of the last interim look within the budget, or None if all looks can run."""
    if cost is None or not trial.budget:
        return None
    hours = [trial.hours(plan, cost) for plan in trial.remaining()]
    return max(sum(hour <= trial.budget for hour in hours) - 1, 0)


def run_looks(trial: TrialRuns, cost: Cost | None, judge: Judge) -> int:
    """Run and evaluate interim looks until the trial or its budget ends, and return the exit code.

    A look starts only if the budget suffices for its missing runs. One that takes longer than estimated is
    stopped with checkpoints, and the same command continues it.
    """
    results = trial.results
    deadline = time.monotonic() + 3600 * trial.budget if trial.budget else None
    for plan in trial.plans:
        left = unfinished(plan, results)
        if left.runs:
            hours = trial.hours(left, cost)
            if deadline is not None and time.monotonic() + 3600 * hours > deadline:
                print_line(
                    f"The budget does not hold the next look, {hours:.1f} h for {len(left.runs)} runs. The "
                    f"same command with another --budget continues."
                )
                return 0
            with _stopped_at(deadline, results):
                code = execute_and_report(plan, results, trial.config, trial.address)
            if code:
                return code
        if judge():
            break
    return 0


@contextmanager
def _stopped_at(deadline: float | None, results: str) -> Iterator[None]:
    """Context manager that stops the campaign on a results root when `time.monotonic` passes `deadline`."""
    if deadline is None:
        yield
        return

    def stop() -> None:
        with suppress(NotRunningError):
            ask_to_stop(Store.open(results))

    timer = Timer(max(deadline - time.monotonic(), 0.0), stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def simulated_cells(teacher: str, places: Sequence[tuple[str, ...]]) -> list[matrix.SimulatedCell]:
    """Return the simulated cells of a trial, one for each cell key in `places`.

    Raises:
        ValueError: if a challenge exceeds the limits that the teacher declares.
    """
    return [
        cell
        for _, challenge, _, _, level in places
        for cell in matrix.cells_of([teacher], [find_simulated_challenge(challenge)], [KnowledgeLevel(level)])
    ]


def simulate_looks(
    cells: Sequence[matrix.SimulatedCell], looks: Sequence[Sequence[int]], options: TrialOptions, judge: Judge
) -> int:
    """Run a trial on simulated students; `looks` has the seeds up to each interim look, see `run_looks`.

    Raises:
        ProcessLostError: if a process was killed; the same call continues.
    """
    for seeds in looks:
        root = SimulatedRoot(options.results, cells, seeds, EPISODES)
        runs = matrix.run_cells(cells, seeds, EPISODES, options.jobs, tuple(root.kept()))
        with closing(runs):
            for run in runs:
                root.add(run)
        if judge():
            break
    return 0
