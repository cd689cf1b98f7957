"""The cost of a plan: hours from speeds measured on this machine, disk and memory."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tma_ray.campaign.costs.speed import Throughput, measure
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, Resources, Settings
from tma_ray.runs.spec import RunSpec

TEST_STEPS = 1_000
"""What a test task is taken to need, in environment steps: half of the most there can be."""

RUN_BYTES = 600_000
"""On disk for each run: its policy, and tables with hardly a row (measured)."""

EVALUATION_BYTES, PROBE_BYTES, STEP_BYTES = 12, 8, 0.04
"""On disk for each test task played, each task probed and each training step (an episode has some 20)."""

PROCESS_BYTES = 0.9 * GIB
"""Memory of a run's processes, student and teacher, without a replay buffer (measured)."""

NETWORK_BYTES = 5e6
"""Of a run's two checkpoints without a replay buffer (measured)."""

BUFFER_SHARE = 1.3
"""Bytes of the checkpoints over those of the replay buffer: parts of the one before are kept (measured)."""

Kind = tuple[Any, ...]
"""What speed depends on: environment with its options, and student."""


@dataclass(frozen=True)
class Cost:
    """Cost of a plan.

    Attributes:
        throughputs: of each kind of run.
        hours: of all runs, one after the other.
        resources: of each run.
        at_once: runs that this machine's cores, and one GPU if they use any, hold at once.
        disk_gib: of all results, GiB.
        checkpoint_gib: of the checkpoints of the largest runs under way at once, GiB.
        memory_gib: of the largest runs under way at once, GiB.
    """

    throughputs: Mapping[Kind, Throughput]
    hours: float
    resources: Resources
    at_once: int
    disk_gib: float
    checkpoint_gib: float
    memory_gib: float

    def summary(self) -> str:
        """Returns the time that it takes."""
        spent = f"{_amount(self.hours * self.resources.cpus)} core-hours"
        if self.resources.gpus:
            spent += f" and {_amount(self.hours * self.resources.gpus)} GPU-hours"
        at_once = f"{self.at_once} {'run' if self.at_once == 1 else 'runs'} at once"
        return f"{spent}, {_time(self.hours / self.at_once)} with {at_once} as on this machine"

    def describe(self) -> str:
        """Returns the cost in three lines."""
        speeds = ", ".join(f"{each.label} {each.training:,.0f}" for each in self.throughputs.values())
        return (
            f"cost: {self.summary()}\n"
            f"  measured here, one run alone, in steps/s: {speeds}\n"
            f"  about {_size(self.disk_gib)} of results; of the runs under way {_size(self.checkpoint_gib)} "
            f"of checkpoints and {_size(self.memory_gib)} of memory"
        )


def estimate(
    plan: Plan,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    speed_of: Callable[[RunSpec, Settings], Throughput | None] | None = None,
) -> Cost:
    """Returns what `plan` costs at the speeds of this machine.

    Takes some four seconds for each kind of run that is measured. Speeds are those of one run alone; teachers
    are left out, who cost milliseconds an episode.

    Args:
        plan: what is to run.
        settings: how it is executed.
        known: throughputs of kinds of runs, as of another `Cost`.
        speed_of: returns the throughput of a kind that is not in `known`; where it returns None, that is
            measured.
    """
    counts: Counter[Kind] = Counter()
    examples: dict[Kind, RunSpec] = {}
    for spec in plan.runs:
        key = (*_kind(spec), spec.schedule, len(spec.test_set))
        counts[key] += 1
        examples.setdefault(key, spec)
    throughputs = dict(known or {})
    for spec in examples.values():
        if _kind(spec) not in throughputs:
            throughputs[_kind(spec)] = (speed_of and speed_of(spec, settings)) or measure(spec, settings)
    buffers = [_buffer_bytes(throughputs[_kind(spec)], spec) for spec in examples.values()]
    at_once = min(len(plan.runs), _at_once(settings.resources))
    return Cost(
        throughputs=throughputs,
        hours=sum(counts[key] * _hours(throughputs[_kind(spec)], spec) for key, spec in examples.items()),
        resources=settings.resources,
        at_once=at_once,
        disk_gib=sum(counts[key] * _result_bytes(spec) for key, spec in examples.items()) / GIB,
        checkpoint_gib=at_once * (NETWORK_BYTES + BUFFER_SHARE * max(buffers)) / GIB,
        memory_gib=at_once * (PROCESS_BYTES + max(buffers)) / GIB,
    )


def _kind(spec: RunSpec) -> Kind:
    return (
        spec.environment,
        repr(sorted(spec.environment_options.items())),
        repr(sorted(spec.inputs.items())),
        spec.student,
    )


def _hours(throughput: Throughput, spec: RunSpec) -> float:
    evaluating = _test_tasks(spec) * TEST_STEPS / throughput.playing
    return (spec.schedule.steps / throughput.training + evaluating) / 3600


def _test_tasks(spec: RunSpec) -> int:
    """Returns how many test tasks a run plays: before the first step, at each interval, after the last."""
    return (math.ceil(spec.schedule.steps / spec.schedule.evaluation_interval) + 1) * len(spec.test_set)


def _result_bytes(spec: RunSpec) -> float:
    schedule = spec.schedule
    probed = (schedule.steps // schedule.probe_interval + 1) * schedule.probe_size
    rows = EVALUATION_BYTES * _test_tasks(spec) + PROBE_BYTES * probed + STEP_BYTES * schedule.steps
    return RUN_BYTES + rows


def _buffer_bytes(throughput: Throughput, spec: RunSpec) -> float:
    size = spec.student_hyperparameters.get("buffer_size", 0)
    return float(throughput.transition_bytes * min(size, spec.schedule.steps))


def _at_once(resources: Resources) -> int:
    by_cores = (os.cpu_count() or 1) / resources.cpus
    by_gpu = 1 / resources.gpus if resources.gpus else math.inf
    return max(1, int(min(by_cores, by_gpu)))


def _amount(hours: float) -> str:
    return f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"


def _time(hours: float) -> str:
    if hours >= 72:
        return f"{hours / 24:,.0f} days"
    return f"{hours:.1f} h" if hours >= 1 else f"{math.ceil(hours * 60)} min"


def _size(gib: float) -> str:
    return f"{gib:,.1f} GiB" if gib >= 1 else f"{max(1, round(gib * 1024))} MiB"
