"""Confirmation of what takes over an hour, before anything is started."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

from tma_ray.campaign.costs.estimation import Cost, Kind, estimate
from tma_ray.campaign.costs.speed import Throughput
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import Settings
from tma_ray.results import Results, ResultsRootError, RunStatus, Store, check_usable
from tma_ray.runs.spec import RunSpec

LONGEST_HOURS = 1.0
"""Time on this machine up to which nothing is asked, h."""


class KnownSpeed(NamedTuple):
    """Steps per second of a student on one core, of training and of evaluations, and the versions of that."""

    training: float
    playing: float
    algorithm_version: int
    physics_version: int


KNOWN = {
    "ppo": KnownSpeed(training=8_000, playing=20_000, algorithm_version=1, physics_version=3),
    "sac": KnownSpeed(training=150, playing=20_000, algorithm_version=1, physics_version=3),
}
"""Speeds of students with their default hyper-parameters, as `speed.measure` found them on an AMD EPYC; they
are used while the versions that they were measured at are current. Others are measured here, in seconds."""

SLOWEST = Throughput("any", training=20, playing=2_000, transition_bytes=0)
"""A run that is slower than any: what takes less than an hour at that speed needs no measurement."""


def long_cost(
    plan: Plan, results: str, settings: Settings, known: Mapping[Kind, Throughput] | None = None
) -> Cost | None:
    """Returns the cost of what is not done of `plan`, None if that takes up to an hour on this machine.

    Args:
        plan: what is to run.
        results: results root, which may have some of the runs.
        settings: how it is executed.
        known: speeds that have been measured.

    Raises:
        ResultsRootError: the root belongs to something else or to another version.
    """
    if _hours(estimate(plan, settings, speed_of=lambda _spec, _settings: SLOWEST)) <= LONGEST_HOURS:
        return None
    runs = _unfinished(plan, results)
    if not runs:
        return None
    cost = estimate(replace(plan, runs=runs), settings, known, known_throughput)
    return cost if _hours(cost) > LONGEST_HOURS else None


def confirm(name: str, cost: Cost, *, yes: bool, ask: Callable[[str], str] | None = None) -> None:
    """Returns if what costs so much shall be started.

    Args:
        name: what is started, for messages.
        cost: what it costs.
        yes: it shall, without a question.
        ask: puts a question to the user and returns the answer; None where nobody can be asked.

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


def terminal_question() -> Callable[[str], str] | None:
    """Returns how to ask at a terminal, None without one."""
    return input if sys.stdin.isatty() and sys.stdout.isatty() else None


def known_throughput(spec: RunSpec, settings: Settings) -> Throughput | None:
    """Returns the throughput of runs like `spec` as `KNOWN` has it, None if that says nothing of them."""
    known = KNOWN.get(spec.student)
    current = (spec.algorithm_versions.get("student"), spec.physics_version)
    if known is None or settings.device != "cpu" or current != known[2:] or "environment" in spec.plugins:
        return None
    label = f"{spec.student} on {spec.environment} {spec.embodiment}".strip()
    return Throughput(label, known.training, known.playing, 0)


def _hours(cost: Cost) -> float:
    return cost.hours / cost.at_once


def _unfinished(plan: Plan, results: str) -> tuple[RunSpec, ...]:
    store = Store.open(results)
    check_usable(store)
    try:
        manifests = Results(store).runs()
    except ResultsRootError:  # nothing is there yet
        return plan.runs
    done = {manifest.run.run_id for manifest in manifests if manifest.status is RunStatus.DONE}
    return tuple(spec for spec in plan.runs if spec.run_id not in done)
