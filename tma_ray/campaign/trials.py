"""The runs of a trial: look after look, within a budget, each judged before the next begins."""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from threading import Timer

from tma_ray.campaign.costs import Cost, estimate, unfinished
from tma_ray.campaign.options import TrialOptions
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.script import executed
from tma_ray.campaign.simulated import SimulatedRoot
from tma_ray.console.terminal import say
from tma_ray.results import NotRunningError, Store, ask_to_stop
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import EPISODES, find_simulated_challenge, matrix

Judge = Callable[[], bool]  # tells the verdicts of the looks so far; returns True if the trial ends there


def campaign_of(teacher: str) -> str:
    """Return the name of the campaign of a trial: its own, as one release may take several trials."""
    return f"trial_{re.sub('[^0-9a-z]+', '_', teacher.lower()).strip('_')}"


def trial_cost(plans: Sequence[Plan], options: TrialOptions) -> Cost | None:
    """Return the cost of all looks but for what is done; None if nothing is left.

    Each of `plans` has the runs until a look, those of the looks before included.

    Raises:
        ResultsRootError: the results root belongs to something else.
    """
    left = unfinished(plans[-1], str(options.results))
    return estimate(left, options.settings(), nodes=options.nodes()) if left.runs else None


def affordable_look(plans: Sequence[Plan], cost: Cost | None, options: TrialOptions) -> int | None:
    """Return the number of the last look that the budget holds, from 0 on; None for all; see `trial_cost`."""
    if cost is None or not options.budget:
        return None
    settings, results, nodes = options.settings(), str(options.results), options.nodes()
    lacking = (unfinished(plan, results) for plan in plans)
    hours = [
        estimate(plan, settings, cost.throughputs, nodes=nodes).wall_hours if plan.runs else 0.0
        for plan in lacking
    ]
    return max(sum(hour <= options.budget for hour in hours) - 1, 0)


def run_looks(plans: Sequence[Plan], cost: Cost | None, options: TrialOptions, judge: Judge) -> int:
    """Run what each look lacks and judge it, until the trial ends or its budget does; return the exit code.

    A look begins only if what it lacks fits into the budget; one that takes longer than expected is stopped
    there, with checkpoints, and the same command continues it.
    """
    settings, results = options.settings(), str(options.results)
    deadline = time.monotonic() + 3600 * options.budget if options.budget else None
    for plan in plans:
        left = unfinished(plan, results)
        if left.runs:
            known = cost.throughputs if cost else None
            hours = estimate(left, settings, known, nodes=options.nodes()).wall_hours
            if deadline is not None and time.monotonic() + 3600 * hours > deadline:
                say(
                    f"The budget does not hold the next look, {hours:.1f} h for {len(left.runs)} runs. The "
                    f"same command with another --budget continues."
                )
                return 0
            with _stopped_at(deadline, results):
                code = executed(plan, results, settings, options.chosen_address())
            if code:
                return code
        if judge():
            break
    return 0


@contextmanager
def _stopped_at(deadline: float | None, results: str) -> Iterator[None]:
    """Ask the campaign on a results root to stop at a time of the monotonic clock."""
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
    """Return the cells of a trial on simulated students, which are the `places` of its design.

    Raises:
        ValueError: a challenge beyond the limits that the teacher declares.
    """
    return [
        cell
        for _, challenge, _, _, level in places
        for cell in matrix.cells_of([teacher], [find_simulated_challenge(challenge)], [KnowledgeLevel(level)])
    ]


def simulate_looks(
    cells: Sequence[matrix.SimulatedCell], looks: Sequence[Sequence[int]], options: TrialOptions, judge: Judge
) -> int:
    """Run a trial on simulated students, as `run_looks`: `looks` are the seeds of every cell until each.

    Raises:
        ProcessLostError: a process was killed; the same call continues.
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
