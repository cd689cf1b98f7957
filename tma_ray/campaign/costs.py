"""Estimated cost of a plan before anything runs: hours, disk and memory; confirmation of what takes long."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, Nodes, Settings, this_machine
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
class Cost:
    """Estimated cost of a plan.

    Attributes:
        throughputs: speed of each kind of run.
        hours: time of all runs, one after the other, h; in cohorts of players' cores.
        core_hours: time of cores, learners' included, h.
        gpu_hours: time of GPUs, h.
        wall_hours: time on the nodes, h.
        how: runs or cohorts at once and the nodes that execute them, in words.
        bound: part that decides the time of cohorts; None if runs learn alone.
        at_once: number of runs that the nodes hold at once.
        disk_gib: size of all results, GiB.
        checkpoint_gib: size of the checkpoints of the largest runs under way at once, GiB.
        memory_gib: memory of the largest runs under way at once, GiB.
    """

    throughputs: Mapping[Kind, Throughput]
    hours: float
    core_hours: float
    gpu_hours: float
    wall_hours: float
    how: str
    bound: str | None
    at_once: int
    disk_gib: float
    checkpoint_gib: float
    memory_gib: float

    def summary(self) -> str:
        """Return the time that it takes, by an estimate."""
        spent = f"{_amount(self.core_hours)} core-hours"
        if self.gpu_hours:
            spent += f" and {_amount(self.gpu_hours)} GPU-hours"
        hours = self.wall_hours
        if hours >= 72:
            time = f"{hours / 24:,.0f} days"
        else:
            time = f"{hours:.1f} h" if hours >= 1 else f"{math.ceil(hours * 60)} min"
        return f"{spent}, {time} with {self.how} (an estimate)"

    def describe(self) -> str:
        """Return the cost in a few lines."""
        each_of = "a player on a core" if self.bound else "each run"
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

    Teachers are left out, which cost milliseconds an episode. `known` has speeds of another `Cost`; others
    are found by `find_speeds`, `known_speeds` by default. Without `nodes` this machine executes the plan.
    """
    nodes = nodes or this_machine()
    counts: Counter[Kind] = Counter()
    examples: dict[Kind, RunSpec] = {}
    for spec in plan.runs:
        key = (*kind_of(spec), spec.schedule, len(spec.test_set))
        counts[key] += 1
        examples.setdefault(key, spec)
    resources = settings.resources
    at_once = min(len(plan.runs), settings.width or nodes.at_once(resources))
    throughputs = dict(known or {})
    kinds = {kind_of(spec): spec for spec in examples.values()}
    missing = {kind: spec for kind, spec in kinds.items() if kind not in throughputs}
    here = 1 if settings.width else min(at_once, this_machine().at_once(resources))
    throughputs |= (find_speeds or known_speeds)(missing, settings, here)
    hours = learner_hours = disk = largest_buffer = 0.0
    for key, spec in examples.items():
        speed, schedule = throughputs[kind_of(spec)], spec.schedule
        # Played before the first step, at each interval, and after the last.
        tests = (math.ceil(schedule.steps / schedule.evaluation_interval) + 1) * len(spec.test_set)
        seconds = START_SECONDS + schedule.steps / speed.training + tests * TEST_STEPS / speed.playing
        hours += counts[key] * seconds / 3600
        learner_hours += counts[key] * schedule.steps / speed.learner / 3600 if speed.learner else 0.0
        probed = (schedule.steps // schedule.probe_interval + 1) * schedule.probe_size
        rows = EVALUATION_BYTES * tests + PROBE_BYTES * probed + STEP_BYTES * schedule.steps
        disk += counts[key] * (RUN_BYTES + rows)
        stored = min(spec.student_hyperparameters.get("buffer_size", 0), schedule.steps)
        largest_buffer = max(largest_buffer, float(speed.transition_bytes * stored))
    core_hours, gpu_hours, wall_hours = hours * resources.cpus, hours * resources.gpus, hours / at_once
    how, bound = f"{at_once} {'run' if at_once == 1 else 'runs'} at once {nodes.place}", None
    if settings.width:
        learners, cores = _learners_and_cores(settings, nodes, len(plan.runs))
        gpus = learners * float(settings.device != "cpu")
        times = {"learner": learner_hours / learners, "players' cores": hours / cores}
        bound, wall_hours = max(times.items(), key=lambda part: part[1])
        core_hours, gpu_hours = hours + wall_hours * learners, wall_hours * gpus
        (other,) = times.keys() - {bound}
        hardware = f"{sum(node.get('CPU', 0) for node in nodes.resources):g} cores"
        if gpus:
            hardware = f"{'one GPU' if learners == 1 else f'{learners} GPUs'} and {hardware}"
        how = (
            f"{'a cohort' if learners == 1 else f'{learners} cohorts'} of {settings.width} runs on "
            f"{hardware} {nodes.place}, bound by the {bound}; the {other} would take "
            f"{times[other] / wall_hours:.0%} of that time"
        )
    return Cost(
        throughputs=throughputs,
        hours=hours,
        core_hours=core_hours,
        gpu_hours=gpu_hours,
        wall_hours=wall_hours,
        how=how,
        bound=bound,
        at_once=at_once,
        disk_gib=disk / GIB,
        checkpoint_gib=at_once * (NETWORK_BYTES + BUFFER_SHARE * largest_buffer) / GIB,
        memory_gib=at_once * ((PLAYER_BYTES if settings.width else PROCESS_BYTES) + largest_buffer) / GIB,
    )


def _learners_and_cores(settings: Settings, nodes: Nodes, runs: int) -> tuple[int, float]:
    """Return the cohorts that `nodes` hold and the runs need, and the cores that are left for players."""
    player = settings.player.cpus
    learners, left = 0, 0.0
    for node in nodes.resources:
        cores = node.get("CPU", 0.0)
        full = max(1, int(cores / (1 + settings.width * player)))
        here = full if settings.device == "cpu" else int(node.get("GPU", 0.0))
        if here and cores:
            learners, left = learners + here, left + max(player, cores - here)
    used = min(max(1, learners), math.ceil(runs / settings.width))
    return used, max(player, left * used / max(1, learners))


def long_cost(
    plan: Plan,
    results: str,
    settings: Settings,
    known: Mapping[Kind, Throughput] | None = None,
    nodes: Nodes | None = None,
) -> Cost | None:
    """Return the cost of the runs of `plan` that `results` lacks, None if that takes up to an hour here.

    See `estimate` for `known` and `nodes`, which execute the plan.

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


def confirm(name: str, cost: Cost, *, yes: bool, address: str | None = None) -> None:
    """Return if a campaign of such a cost is to be started: `yes`, or the user says so at the terminal.

    With the address of a cluster nobody is asked: ``ray submit --tmux`` gives a terminal that nobody watches.

    Raises:
        ValueError: it is not to be started, or nobody can be asked.
    """
    if yes:
        return
    remedy = "choose a smaller budget, as with --steps 500k or --seeds 3, or pass --yes to start it"
    if address is not None or not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ValueError(f"{name} would take {cost.summary()}: {remedy}")
    if input(f"Start {name}? It takes {cost.summary()}. [y/N] ").strip().lower() not in ("y", "yes"):
        raise ValueError(f"not started; {remedy}")


def _amount(hours: float) -> str:
    return f"{hours:,.0f}" if hours >= 10 else f"{hours:.2g}"


def _size(gib: float) -> str:
    return f"{gib:,.1f} GiB" if gib >= 1 else f"{max(1, round(gib * 1024))} MiB"
