"""Estimated cost of a plan before anything runs: hours, disk and memory; confirmation of what takes long."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, Nodes, Resources, Settings, this_machine
from tma_ray.campaign.speeds import Kind, SpeedFinder, Throughput, kind_of, known_speeds
from tma_ray.results import Results, ResultsRootError, RunStatus, Store, check_usable
from tma_ray.runs.spec import RunSpec

TEST_STEPS = 1_000
"""Environment steps of a test task: half of the most there can be."""

START_SECONDS = 8.0
"""Time of one core for a run's processes before the first step and after the last, s (measured)."""

RUN_BYTES = 600_000
"""Size on disk of a run's policy and tables with hardly a row (measured)."""

EVALUATION_BYTES, PROBE_BYTES, STEP_BYTES = 12, 8, 0.04
"""Size on disk of each test task played, each task probed and each training step (an episode has some 20)."""

PROCESS_BYTES, PLAYER_BYTES = 0.9 * GIB, 0.5 * GIB
"""Memory of a run's processes without a replay buffer (measured): alone with its teacher, and in a cohort."""

NETWORK_BYTES = 5e6
"""Size of a run's two checkpoints without a replay buffer (measured)."""

BUFFER_SHARE = 1.3
"""Bytes of the checkpoints over those of the replay buffer: parts of the one before are kept (measured)."""

LONGEST_HOURS = 1.0
"""Longest time on this machine that needs no confirmation, h."""

SLOWEST = Throughput("any", training=20, playing=2_000, transition_bytes=0, learner=20)
"""A run that is slower than any: an hour at that speed needs no better estimate."""


@dataclass(frozen=True)
class Sharing:
    """Use of nodes by cohorts, whose time is bound by the learners or by the cores of their players.

    Attributes:
        width: slots of each cohort.
        learners: cohorts that the nodes hold and the runs need.
        gpus: GPUs of each learner.
        cores: cores that are left for players.
        learner_hours: time of all runs with one full learner, h.
        player_hours: time of all runs with one core for players, h.
    """

    width: int
    learners: int
    gpus: float
    cores: float
    learner_hours: float
    player_hours: float

    @classmethod
    def of(
        cls, settings: Settings, nodes: Nodes, runs: int, learner_hours: float, player_hours: float
    ) -> Sharing:
        """Return the use that a number of runs makes of `nodes`: a cohort per GPU, or as cores suffice."""
        gpus, player = float(settings.device != "cpu"), settings.player.cpus
        learners, left = 0, 0.0
        for node in nodes.resources:
            cores = node.get("CPU", 0.0)
            full = max(1, int(cores / (1 + settings.width * player)))
            here = int(node.get("GPU", 0.0)) if gpus else full
            if here and cores:
                learners, left = learners + here, left + max(player, cores - here)
        used = min(max(1, learners), math.ceil(runs / settings.width))
        cores = max(player, left * used / max(1, learners))
        return cls(settings.width, used, gpus, cores, learner_hours, player_hours)

    @property
    def hours(self) -> float:
        """Time on these nodes, h."""
        return max(self.learner_hours / self.learners, self.player_hours / self.cores)

    @property
    def bound_by(self) -> str:
        """Part that decides the time."""
        by_learner = self.learner_hours / self.learners >= self.player_hours / self.cores
        return "learner" if by_learner else "players' cores"

    def summary(self, nodes: Nodes) -> str:
        """Return the cohorts, the nodes, and the part that decides the time, with the share of the other."""
        cores = f"{sum(node.get('CPU', 0) for node in nodes.resources):g} cores"
        gpus = "one GPU" if self.learners == 1 else f"{self.learners} GPUs"
        cohorts = "a cohort" if self.learners == 1 else f"{self.learners} cohorts"
        faster = "learner" if self.bound_by != "learner" else "players' cores"
        times = self.learner_hours / self.learners, self.player_hours / self.cores
        hardware = f"{gpus} and {cores}" if self.gpus else cores
        return (
            f"{cohorts} of {self.width} runs on {hardware} {nodes.place}, bound by the {self.bound_by}; the "
            f"{faster} would take {min(times) / max(times):.0%} of that time"
        )


@dataclass(frozen=True)
class Cost:
    """Estimated cost of a plan.

    Attributes:
        throughputs: speed of each kind of run.
        hours: time of all runs, one after the other, h; in cohorts of players' cores.
        resources: resources of each run.
        nodes: nodes that execute it.
        at_once: number of runs that these hold at once.
        disk_gib: size of all results, GiB.
        checkpoint_gib: size of the checkpoints of the largest runs under way at once, GiB.
        memory_gib: memory of the largest runs under way at once, GiB.
        sharing: use of learners, None if runs learn alone.
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
        """Time of cores, learners' included, h."""
        if self.sharing:
            return self.sharing.player_hours + self.sharing.hours * self.sharing.learners
        return self.hours * self.resources.cpus

    @property
    def gpu_hours(self) -> float:
        """Time of GPUs, h."""
        if self.sharing:
            return self.sharing.hours * self.sharing.learners * self.sharing.gpus
        return self.hours * self.resources.gpus

    def summary(self) -> str:
        """Return the time that it takes, by an estimate."""
        spent = f"{_amount(self.core_hours)} core-hours"
        if self.gpu_hours:
            spent += f" and {_amount(self.gpu_hours)} GPU-hours"
        at_once = f"{self.at_once} {'run' if self.at_once == 1 else 'runs'} at once {self.nodes.place}"
        how = self.sharing.summary(self.nodes) if self.sharing else at_once
        return f"{spent}, {_time(self.wall_hours)} with {how} (an estimate)"

    def describe(self) -> str:
        """Return the cost in a few lines."""
        each_of = "a player on a core" if self.sharing else "each run"
        kinds = [
            f"\n    {each.label} {each.training:,.0f}"
            + (f" (a full learner {each.learner:,.0f})" if each.learner else "")
            for each in self.throughputs.values()
        ]
        return (
            f"cost: {self.summary()}\n"
            f"  speed of this machine, in steps/s of {each_of}:{''.join(kinds)}\n"
            f"  disk: about {_size(self.disk_gib)} of results, "
            f"and {_size(self.checkpoint_gib)} of checkpoints of the runs under way\n"
            f"  memory: about {_size(self.memory_gib)} for the runs under way"
        )


def estimate(
    plan: Plan,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    find_speeds: SpeedFinder | None = None,
    nodes: Nodes | None = None,
) -> Cost:
    """Return the estimated cost of `plan` at the speeds of this machine.

    Teachers are left out, which cost milliseconds an episode.

    Args:
        plan: runs to execute.
        settings: resources and placement of the runs.
        known: speeds of kinds of runs, as of another `Cost`.
        find_speeds: finder of the speeds that are not in `known`; by default `known_speeds`.
        nodes: nodes that execute it; None for this machine.
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
    here = 1 if settings.width else min(at_once, this_machine().at_once(settings.resources))
    throughputs |= (find_speeds or known_speeds)(missing, settings, here)
    hours = learner_hours = disk = largest_buffer = 0.0
    for key, spec in examples.items():
        speed, steps = throughputs[kind_of(spec)], spec.schedule.steps
        evaluating = _test_tasks(spec) * TEST_STEPS / speed.playing
        hours += counts[key] * (START_SECONDS + steps / speed.training + evaluating) / 3600
        learner_hours += counts[key] * steps / speed.learner / 3600 if speed.learner else 0.0
        disk += counts[key] * _result_bytes(spec)
        rows = min(spec.student_hyperparameters.get("buffer_size", 0), steps)
        largest_buffer = max(largest_buffer, float(speed.transition_bytes * rows))
    return Cost(
        throughputs=throughputs,
        hours=hours,
        resources=settings.each,
        nodes=nodes,
        at_once=at_once,
        disk_gib=disk / GIB,
        checkpoint_gib=at_once * (NETWORK_BYTES + BUFFER_SHARE * largest_buffer) / GIB,
        memory_gib=at_once * ((PLAYER_BYTES if settings.width else PROCESS_BYTES) + largest_buffer) / GIB,
        sharing=Sharing.of(settings, nodes, len(plan.runs), learner_hours, hours) if settings.width else None,
    )


def long_cost(
    plan: Plan,
    results: str,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    nodes: Nodes | None = None,
) -> Cost | None:
    """Return the cost of the runs of `plan` that are not done, None if that takes up to an hour here.

    Args:
        plan: runs to execute.
        results: results root, which may have some of the runs.
        settings: resources and placement of the runs.
        known: speeds of kinds of runs, as of another `Cost`.
        nodes: nodes that the returned cost is for; None for this machine.

    Raises:
        ResultsRootError: the root belongs to something else or to another version.
    """
    slowest = estimate(plan, settings, find_speeds=lambda kinds, *_: dict.fromkeys(kinds, SLOWEST))
    if slowest.wall_hours <= LONGEST_HOURS:
        return None
    left = replace(plan, runs=unfinished(plan, results))
    if not left.runs:
        return None
    cost = estimate(left, settings, known)
    if cost.wall_hours <= LONGEST_HOURS:
        return None
    return estimate(left, settings, cost.throughputs, nodes=nodes) if nodes else cost


def unfinished(plan: Plan, results: str) -> tuple[RunSpec, ...]:
    """Return the runs of a plan that are not done in a results root.

    Raises:
        ResultsRootError: the root belongs to something else or to another version.
    """
    store = Store.open(results)
    check_usable(store)
    try:
        done = {each.run.run_id for each in Results(store).runs() if each.status is RunStatus.DONE}
    except ResultsRootError:  # nothing is there yet
        return plan.runs
    return tuple(spec for spec in plan.runs if spec.run_id not in done)


def confirm(name: str, cost: Cost, *, yes: bool, ask: Callable[[str], str] | None = None) -> None:
    """Return if a campaign of such a cost is to be started.

    Args:
        name: name of the campaign, for messages.
        cost: cost of the campaign.
        yes: True to start it without a question.
        ask: function that asks the user a question and returns the answer; None without a terminal.

    Raises:
        ValueError: it is not to be started, or nobody can be asked.
    """
    if yes:
        return
    remedy = "choose a smaller budget, as with --steps 500k or --seeds 3, or pass --yes to start it"
    if ask is None:
        raise ValueError(f"{name} would take {cost.summary()}: {remedy}")
    if ask(f"Start {name}? It takes {cost.summary()}. [y/N] ").strip().lower() not in ("y", "yes"):
        raise ValueError(f"not started; {remedy}")


def terminal_question(address: str | None = None) -> Callable[[str], str] | None:
    """Return a function that asks at the terminal, None without one.

    A campaign with the address of a cluster asks nobody: ``ray submit --tmux`` gives it a terminal that
    nobody watches.
    """
    return input if address is None and sys.stdin.isatty() and sys.stdout.isatty() else None


def _test_tasks(spec: RunSpec) -> int:
    """Return the number of test tasks played before the first step, at each interval, after the last."""
    return (math.ceil(spec.schedule.steps / spec.schedule.evaluation_interval) + 1) * len(spec.test_set)


def _result_bytes(spec: RunSpec) -> float:
    schedule = spec.schedule
    probed = (schedule.steps // schedule.probe_interval + 1) * schedule.probe_size
    rows = EVALUATION_BYTES * _test_tasks(spec) + PROBE_BYTES * probed + STEP_BYTES * schedule.steps
    return RUN_BYTES + rows


def _amount(hours: float) -> str:
    return f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"


def _time(hours: float) -> str:
    if hours >= 72:
        return f"{hours / 24:,.0f} days"
    return f"{hours:.1f} h" if hours >= 1 else f"{math.ceil(hours * 60)} min"


def _size(gib: float) -> str:
    return f"{gib:,.1f} GiB" if gib >= 1 else f"{max(1, round(gib * 1024))} MiB"
