"""Confirmation of what takes over an hour, before anything is started."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace

from tma_ray.campaign.costs.estimation import Cost, estimate
from tma_ray.campaign.costs.known import Kind, quick_speeds
from tma_ray.campaign.costs.speed import Throughput
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import Nodes, Settings
from tma_ray.results import Results, ResultsRootError, RunStatus, Store, check_usable
from tma_ray.runs.spec import RunSpec

LONGEST_HOURS = 1.0
"""Time on this machine up to which nothing is asked, h."""


SLOWEST = Throughput("any", training=20, playing=2_000, transition_bytes=0, learner=20)
"""A run that is slower than any: what takes less than an hour at that speed needs no measurement."""


def long_cost(
    plan: Plan,
    results: str,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    nodes: Nodes | None = None,
) -> Cost | None:
    """Returns the cost of what is not done of `plan`, None if that takes up to an hour on this machine.

    Args:
        plan: what is to run.
        results: results root, which may have some of the runs.
        settings: how it is executed.
        known: speeds that have been measured.
        nodes: nodes that the returned cost is for; None: this machine.

    Raises:
        ResultsRootError: the root belongs to something else or to another version.
    """
    if _hours(estimate(plan, settings, find_speeds=_slowest)) <= LONGEST_HOURS:
        return None
    runs = unfinished(plan, results)
    if not runs:
        return None
    left = replace(plan, runs=runs)
    cost = estimate(left, settings, known, quick_speeds)
    if _hours(cost) <= LONGEST_HOURS:
        return None
    return estimate(left, settings, cost.throughputs, nodes=nodes) if nodes else cost


def confirm(name: str, cost: Cost, *, yes: bool, ask: Callable[[str], str] | None = None) -> None:
    """Returns if what costs so much shall be started.

    Args:
        name: what is started, for messages.
        cost: what it costs.
        yes: it shall, without a question.
        ask: puts a question to the user and returns the answer; None where nobody may be there to answer.

    Raises:
        ValueError: it shall not, or nobody can be asked.
    """
    if yes:
        return
    remedy = "choose a smaller budget, as with --steps 500k or --seeds 3, or pass --yes to start it"
    if ask is None:
        raise ValueError(f"{name} would take {cost.summary()}: {remedy}")
    if ask(f"Start {name}? It takes {cost.summary()}. [y/N] ").strip().lower() not in ("y", "yes"):
        raise ValueError(f"not started; {remedy}")


def terminal_question(address: str | None = None) -> Callable[[str], str] | None:
    """Returns how to ask at a terminal, None without one.

    A campaign with the address of a cluster asks nobody: ``ray submit --tmux`` gives it a terminal that
    nobody watches.
    """
    return input if address is None and sys.stdin.isatty() and sys.stdout.isatty() else None


def _slowest(examples: Mapping[Kind, RunSpec], *_: object) -> Mapping[Kind, Throughput]:
    return dict.fromkeys(examples, SLOWEST)


def _hours(cost: Cost) -> float:
    return cost.wall_hours


def unfinished(plan: Plan, results: str) -> tuple[RunSpec, ...]:
    """Returns the runs of a plan that are not done in a results root."""
    store = Store.open(results)
    check_usable(store)
    try:
        manifests = Results(store).runs()
    except ResultsRootError:  # nothing is there yet
        return plan.runs
    done = {manifest.run.run_id for manifest in manifests if manifest.status is RunStatus.DONE}
    return tuple(spec for spec in plan.runs if spec.run_id not in done)
