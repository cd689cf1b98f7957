"""The cost of a plan: hours from speeds measured on this machine, disk and memory."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tma_ray.campaign.costs.known import Kind, kind_of, measured_speeds
from tma_ray.campaign.costs.sharing import Sharing
from tma_ray.campaign.costs.speed import Source, Throughput
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, Nodes, Resources, Settings, this_machine
from tma_ray.runs.spec import RunSpec

TEST_STEPS = 1_000
"""What a test task is taken to need, in environment steps: half of the most there can be."""

START_SECONDS = 8.0
"""Of a run's processes before their first step and after their last, in seconds of one core (measured)."""

RUN_BYTES = 600_000
"""On disk for each run: its policy, and tables with hardly a row (measured)."""

EVALUATION_BYTES, PROBE_BYTES, STEP_BYTES = 12, 8, 0.04
"""On disk for each test task played, each task probed and each training step (an episode has some 20)."""

PROCESS_BYTES = 0.9 * GIB
"""Memory of a run's processes, student and teacher, without a replay buffer (measured)."""

PLAYER_BYTES = 0.5 * GIB
"""The same of a run in a cohort, whose learner has the replay buffers of all."""

NETWORK_BYTES = 5e6
"""Of a run's two checkpoints without a replay buffer (measured)."""

BUFFER_SHARE = 1.3
"""Bytes of the checkpoints over those of the replay buffer: parts of the one before are kept (measured)."""

SpeedFinder = Callable[[Mapping[Kind, RunSpec], Settings, int], Mapping[Kind, Throughput]]
"""Returns the speeds of kinds of runs, given an example of each, settings and how many run at once."""

ORIGINS = {
    Source.MEASURED: "measured here",
    Source.REMEMBERED: "measured here before",
    Source.SHIPPED: "not measured here yet, as on another machine",
}
"""Descriptions of where speeds are from."""


@dataclass(frozen=True)
class Cost:
    """Cost of a plan.

    Attributes:
        throughputs: of each kind of run.
        hours: of all runs, one after the other.
        resources: of each run.
        nodes: nodes that execute it.
        at_once: runs that these hold at once.
        disk_gib: of all results, GiB.
        checkpoint_gib: of the checkpoints of the largest runs under way at once, GiB.
        memory_gib: of the largest runs under way at once, GiB.
        sharing: of learners, if runs learn in cohorts; hours are then those of players' cores.
    """

    throughputs: Mapping[Kind, Throughput]
    hours: float
    resources: Resources
    nodes: Nodes
    at_once: int
    disk_gib: float
    checkpoint_gib: float
    memory_gib: float
    sharing: Sharing | None = None

    @property
    def wall_hours(self) -> float:
        """Time on these nodes, h."""
        return self.sharing.hours if self.sharing else self.hours / self.at_once

    @property
    def core_hours(self) -> float:
        """Time of cores, h."""
        return self.sharing.core_hours if self.sharing else self.hours * self.resources.cpus

    @property
    def gpu_hours(self) -> float:
        """Time of GPUs, h."""
        return self.sharing.gpu_hours if self.sharing else self.hours * self.resources.gpus

    def summary(self) -> str:
        """Returns the time that it takes."""
        if self.sharing:
            return self._shared_summary(self.sharing)
        spent = f"{_amount(self.hours * self.resources.cpus)} core-hours"
        if self.resources.gpus:
            spent += f" and {_amount(self.hours * self.resources.gpus)} GPU-hours"
        at_once = f"{self.at_once} {'run' if self.at_once == 1 else 'runs'} at once"
        return f"{spent}, {_time(self.hours / self.at_once)} with {at_once} {self.nodes.place}"

    def _shared_summary(self, sharing: Sharing) -> str:
        spent = f"{_amount(self.core_hours)} core-hours"
        if sharing.gpus:
            spent = f"{_amount(self.gpu_hours)} GPU-hours and {spent}"
        one = sharing.learners == 1
        cores = f"{sum(node.get('CPU', 0) for node in self.nodes.resources):g} cores"
        gpus = "one GPU" if one else f"{sharing.learners} GPUs"
        return (
            f"{spent}, {_time(sharing.hours)} with {'a cohort' if one else f'{sharing.learners} cohorts'} of "
            f"{sharing.width} runs on {f'{gpus} and {cores}' if sharing.gpus else cores} {self.nodes.place}, "
            f"{sharing.bound}"
        )

    def describe(self) -> str:
        """Returns the cost in a few lines."""
        return (
            f"cost: {self.summary()}\n"
            f"{self._speeds()}\n"
            f"  disk: about {_size(self.disk_gib)} of results, "
            f"and {_size(self.checkpoint_gib)} of checkpoints of the runs under way\n"
            f"  memory: about {_size(self.memory_gib)} for the runs under way"
        )

    def _speeds(self) -> str:
        """Returns the speeds by their origin, a line each."""
        origins = {each.source: [] for each in self.throughputs.values()}  # type: dict[Source, list[str]]
        for each in self.throughputs.values():
            fed = f" (a full learner {each.learner:,.0f})" if each.learner else ""
            origins[each.source].append(f"{each.label} {each.training:,.0f}{fed}")
        here = min(self.at_once, this_machine().at_once(self.resources))
        each_of = "a player on a core" if self.sharing else f"{here} at once, in steps/s of each"
        return "\n".join(
            "\n    ".join((f"  {ORIGINS[source]}, {each_of}:", *speeds))
            for source, speeds in sorted(origins.items())
        )


def estimate(
    plan: Plan,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    find_speeds: SpeedFinder | None = None,
    nodes: Nodes | None = None,
) -> Cost:
    """Returns what `plan` costs at the speeds of this machine.

    Speeds are those of as many runs at once as fit here; teachers are left out, who cost milliseconds an
    episode.

    Args:
        plan: what is to run.
        settings: how it is executed.
        known: throughputs of kinds of runs, as of another `Cost`.
        find_speeds: finds those of kinds that are not in `known`; by default they are measured, within
            seconds, unless that was done before.
        nodes: nodes that execute it; None: this machine.
    """
    nodes = nodes or this_machine()
    counts: Counter[Kind] = Counter()
    examples: dict[Kind, RunSpec] = {}
    for spec in plan.runs:
        key = (*kind_of(spec), spec.schedule, len(spec.test_set))
        counts[key] += 1
        examples.setdefault(key, spec)
    at_once = min(len(plan.runs), settings.width or nodes.at_once(settings.resources))
    throughputs = dict(known or {})
    kinds = {kind_of(spec): spec for spec in examples.values()}
    missing = {kind: spec for kind, spec in kinds.items() if kind not in throughputs}
    measured_at_once = 1 if settings.width else min(at_once, this_machine().at_once(settings.resources))
    throughputs |= (find_speeds or measured_speeds)(missing, settings, measured_at_once)
    buffers = [_buffer_bytes(throughputs[kind_of(spec)], spec) for spec in examples.values()]
    hours = sum(counts[key] * _hours(throughputs[kind_of(spec)], spec) for key, spec in examples.items())
    learning = sum(
        counts[key] * _learner_hours(throughputs[kind_of(spec)], spec) for key, spec in examples.items()
    )
    process = PLAYER_BYTES if settings.width else PROCESS_BYTES
    return Cost(
        throughputs=throughputs,
        hours=hours,
        resources=settings.each,
        nodes=nodes,
        at_once=at_once,
        disk_gib=sum(counts[key] * _result_bytes(spec) for key, spec in examples.items()) / GIB,
        checkpoint_gib=at_once * (NETWORK_BYTES + BUFFER_SHARE * max(buffers)) / GIB,
        memory_gib=at_once * (process + max(buffers)) / GIB,
        sharing=Sharing.of(settings, nodes, len(plan.runs), learning, hours) if settings.width else None,
    )


def _hours(throughput: Throughput, spec: RunSpec) -> float:
    evaluating = _test_tasks(spec) * TEST_STEPS / throughput.playing
    return (START_SECONDS + spec.schedule.steps / throughput.training + evaluating) / 3600


def _learner_hours(throughput: Throughput, spec: RunSpec) -> float:
    """Returns the time of a full learner that a run takes; 0 of one that learns alone."""
    return spec.schedule.steps / throughput.learner / 3600 if throughput.learner else 0.0


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


def _amount(hours: float) -> str:
    return f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"


def _time(hours: float) -> str:
    if hours >= 72:
        return f"{hours / 24:,.0f} days"
    return f"{hours:.1f} h" if hours >= 1 else f"{math.ceil(hours * 60)} min"


def _size(gib: float) -> str:
    return f"{gib:,.1f} GiB" if gib >= 1 else f"{max(1, round(gib * 1024))} MiB"
