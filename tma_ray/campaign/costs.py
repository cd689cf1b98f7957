"""Estimation of a plan's cost: speeds, hours, disk space and memory.

Speeds come from a table, scaled to this machine, or are measured. ``python -m tma_ray.campaign.costs``
measures in a separate process, and prints them as JSON.
"""

import csv
import json
import math
import os
import pickle
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from statistics import mean
from typing import Any, Final

import numpy as np

from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, ExecutionConfig, Nodes, this_machine
from tma_ray.console.terminal import terminal
from tma_ray.embodiments import embodiment_names
from tma_ray.results import Results, ResultsRootError, RunStatus, Store, check_usable
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.inputs import REGISTRIES, arguments, contents, import_plugins, new_environment, provide
from tma_ray.runs.placement import is_available
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Transition, make_student
from tma_ray.support.component_names import base_name
from tma_ray.support.texts import counted, estimated_duration, hours_text, size_text

SpeedKey = tuple[Any, ...]
"""Properties of a run that determine its speed: environment with options and files, and student."""

DEFAULT_BODY: Final = "classic_bipedal"  # body whose speeds are used for bodies that the table lacks
REFERENCE_ROUNDS: Final = 247.0  # `machine_speed` of the machine on which the table was measured

LEARNER_SPEEDS: Final = {
    ("ppo", "cpu", "highest"): 11_000.0,
    ("sac", "cpu", "highest"): 120.0,
    ("sac", "cuda", "highest"): 41_500.0,
    ("sac", "cuda", "high"): 63_700.0,
    ("sac", "cuda", "medium"): 72_900.0,
    ("ppo", "cuda", "highest"): 152_000.0,
}
"""Environment steps per second that a full learner of 48 slots sustains, without compiled updates, by
student, device and precision, on one core of the table's machine or an H100
(benchmarks/measured/2026-11.md)."""

PLAYER_SPEEDS: Final = 30_000.0, 20_000.0
"""Steps per second of a rollout worker in a cohort, on one core of the same machine, in training and in
evaluations."""

MEASURED_SECONDS = 0.6
"""Shortest measurement, s, after a warm-up of half that time."""

MACHINE_SECONDS: Final = 0.4  # processor time over which `machine_speed` measures, s

SMALLER: Final = {"exploration_steps": 1_000, "learning_starts": 1_000, "buffer_size": 50_000}
"""Upper limits on students' hyper-parameters during a measurement."""

CHUNKS: Final = ("steps_per_update", "n_steps", "train_freq")
"""Hyper-parameters for the number of steps between updates, so that whole updates are measured."""

ROUNDS: Final = """
import sys, time
import numpy as np
weights, inputs = np.full((400, 300), 0.01, np.float32), np.ones((64, 400), np.float32)
began, rounds = time.process_time(), 0
while (spent := time.process_time() - began) < float(sys.argv[1]):
    for _ in range(20):
        np.tanh(inputs @ weights)
    sum(range(20_000))
    rounds += 1
print(rounds / spent)
"""
"""Script of `machine_speed`, which runs network layers and interpreted Python loops."""


@dataclass(frozen=True)
class Throughput:
    """Speed of one kind of run.

    Attributes:
        label: student, environment and body.
        training: environment steps per second in training; in a cohort, those of a rollout worker
            that never waits.
        playing: environment steps per second of an evaluation.
        transition_bytes: size of one transition in a replay buffer.
        learner: environment steps per second that a full cohort's learner sustains; 0 without a cohort.
    """

    label: str
    training: float
    playing: float
    transition_bytes: int
    learner: float = 0.0


SpeedFinder = Callable[[Mapping[SpeedKey, RunSpec], ExecutionConfig, int], Mapping[SpeedKey, Throughput]]
"""Function (example runs by kind, configuration, number of concurrent runs) that returns speeds by kind."""


def speed_key(spec: RunSpec) -> SpeedKey:
    """Return the properties of a run that determine its speed."""
    options, inputs = sorted(spec.environment_options.items()), sorted(spec.inputs.items())
    return spec.environment, repr(options), repr(inputs), spec.student


def label_of(spec: RunSpec) -> str:
    """Return a run's student, environment and body as a label for display."""
    return f"{spec.student} on {spec.environment} {spec.embodiment}".strip()


def known_speeds(
    examples: Mapping[SpeedKey, RunSpec], config: ExecutionConfig, at_once: int
) -> Mapping[SpeedKey, Throughput]:
    """Return the speed of each kind of run, scaled from the table, or measured if the table lacks it.

    Raises:
        ValueError: if a measured run fails.
    """
    on_gpu = not config.width and config.device != "cpu" and is_available(config.device)
    listed: dict[SpeedKey, Throughput] = {}
    for key, spec in examples.items():
        body = base_name(spec.embodiment)
        if on_gpu or "environment" in spec.plugins or body not in embodiment_names():
            continue
        student = base_name(spec.student) if config.width else spec.student
        row = _table().get((student, body)) or _table().get((student, DEFAULT_BODY))
        if row is not None:
            scale = machine_speed(at_once) / REFERENCE_ROUNDS
            speed = _shared(replace(row, label=label_of(spec)), spec, config)
            listed[key] = replace(
                speed,
                training=scale * speed.training,
                playing=scale * speed.playing,
                learner=speed.learner * (scale if config.device == "cpu" else 1.0),
            )
    missing = {key: spec for key, spec in examples.items() if key not in listed}
    return listed | measured_speeds(missing, config)


def measured_speeds(
    examples: Mapping[SpeedKey, RunSpec],
    config: ExecutionConfig,
    at_once: int = 1,  # noqa: ARG001  # signature of a `SpeedFinder`
) -> dict[SpeedKey, Throughput]:
    """Measure the speed of each kind of run on this machine; speeds in cohorts come from `LEARNER_SPEEDS`.

    Each takes a few seconds, or half a minute if kernels must be compiled. A separate process measures, so
    that this one loads neither torch nor a GPU.

    Raises:
        ValueError: if a run fails; the message has the last line of its error.
    """
    if not examples:
        return {}
    alone = config
    if config.width or not is_available(config.device):  # cannot be measured here
        alone = replace(config, device="cpu", cohort=0, resources=replace(config.resources, gpus=0))
    specs = list(examples.values())
    request = pickle.dumps(([spec.to_dict() for spec in specs], alone, contents(specs), sys.path))
    label = f"measuring the speed of {counted(len(specs), 'kind of run', 'kinds of runs')}"
    terminal(stderr=True).print(f"{label}, some seconds", highlight=False)
    measurement = subprocess.run(
        [sys.executable, "-m", "tma_ray.campaign.costs"],
        input=request,
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    if measurement.returncode:
        *_, error = ["it was ended", *measurement.stderr.decode(errors="replace").strip().splitlines()]
        raise ValueError(f"cannot measure the speed of {', '.join(map(label_of, specs))}: {error}")
    speeds = zip(examples.items(), json.loads(measurement.stdout), strict=True)
    return {key: _shared(Throughput(**speed), spec, config) for (key, spec), speed in speeds}


@cache
def machine_speed(at_once: int) -> float:
    """Return the mean speed of a core, in rounds of `ROUNDS` per second, with `at_once` processes running."""
    processes = [
        subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", ROUNDS, str(MACHINE_SECONDS)],
            stdout=subprocess.PIPE,
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        for _ in range(at_once)
    ]
    return mean(float(process.communicate()[0]) for process in processes)


def measure(spec: RunSpec, config: ExecutionConfig) -> Throughput:
    """Measure the speed of a run on a single task, without a teacher; takes about two seconds.

    Time is processor time, which other processes hardly affect, or wall time with a GPU.
    """
    environment = new_environment(spec)
    observations, actions = environment.observation_space, environment.action_space
    values, threads = arguments(spec, "student"), config.resources.threads
    values |= {name: min(values[name], most) for name, most in SMALLER.items() if name in values}
    if "updates" in values:
        values["updates"] = (
            "interleaved"  # updates postponed to the end of a long episode would outlast the measurement
        )
    parts = base_name(spec.student), observations, actions, np.random.SeedSequence(0), values
    student = make_student(*parts, config.device, threads)
    chunk = next((int(values[name]) for name in CHUNKS if isinstance(values.get(name), int)), 100)
    options = {"task": spec.task_space.centre}
    observation = environment.reset(seed=0, options=options)[0]

    def clock() -> float:
        return time.process_time() / threads if config.device == "cpu" else time.perf_counter()

    def train(steps: int) -> None:
        nonlocal observation
        for _ in range(steps):
            action = student.act(observation)
            following, reward, terminated, truncated, _ = environment.step(action)
            student.observe(Transition(observation, action, float(reward), following, terminated, truncated))
            ended = terminated or truncated
            observation = environment.reset(options=options)[0] if ended else following

    def training_speed(seconds: float) -> float:
        start, steps = clock(), 0
        while (spent := clock() - start) < seconds:
            train(chunk)
            steps += chunk
        return steps / spent

    train(SMALLER["learning_starts"])
    training_speed(MEASURED_SECONDS / 2)
    training = training_speed(MEASURED_SECONDS)
    environment.close()
    playing = 0.0
    for tasks in (spec.test_set.tasks[:1], spec.test_set.tasks[::10]):  # the first pass compiles kernels
        evaluation = Evaluation(replace(spec, test_set=replace(spec.test_set, tasks=tasks)))
        start = clock()
        steps = sum(row["length"] for row in evaluation(student.act_greedily))
        playing = steps / (clock() - start)
        evaluation.close()
    numbers = math.prod(observations.shape or ()) + math.prod(actions.shape or ()) + 2
    return Throughput(label_of(spec), training, playing, 4 * numbers)


@cache
def _table() -> Mapping[tuple[str, str], Throughput]:
    """Return the packaged table of speeds on one core, by student and body."""
    text = resources.files("tma_ray.campaign").joinpath("speeds.csv").read_text()
    return {
        (row["student"], row["embodiment"]): Throughput(
            "", float(row["training"]), float(row["playing"]), int(row["transition_bytes"])
        )
        for row in csv.DictReader(text.splitlines())
    }


def _shared(alone: Throughput, spec: RunSpec, config: ExecutionConfig) -> Throughput:
    """Return the speed in a cohort if `config` uses cohorts, else `alone`."""
    if not config.width:
        return alone
    student, device = base_name(spec.student), config.device.partition(":")[0]
    precision = str(spec.student_hyperparameters.get("matmul_precision"))
    default = LEARNER_SPEEDS[student, device, "highest"]
    learner = LEARNER_SPEEDS.get((student, device, precision), default)
    return replace(alone, training=PLAYER_SPEEDS[0], playing=PLAYER_SPEEDS[1], learner=learner)


TEST_STEPS = 1_000  # assumed length of test episodes, half the step limit

START_SECONDS = 8.0
"""Core time of a run's processes before the first step and after the last, s (measured)."""

RUN_BYTES = 600_000  # size on disk of a run's policy and nearly empty tables, bytes (measured)

EVALUATION_BYTES, PROBE_BYTES, STEP_BYTES = 12, 8, 0.04
"""Size on disk of each test episode, each probed task and each training step, bytes."""

PROCESS_BYTES, WORKER_BYTES = 0.9 * GIB, 0.5 * GIB
"""Memory of a run with its teacher and of a run in a cohort, without replay buffers, bytes (measured)."""

NETWORK_BYTES = 5e6  # size of a run's two checkpoints without a replay buffer, bytes (measured)

BUFFER_SHARE = 1.3
"""Size of both checkpoints as a multiple of the replay buffer's (measured)."""

LONGEST_HOURS = 1.0  # longest time that needs no confirmation on this machine, h

SLOWEST = Throughput("any", training=20, playing=2_000, transition_bytes=0, learner=20)
"""Lower bound of all speeds: plans of under an hour at this speed need no better estimate."""


@dataclass(frozen=True)
class Cost:
    """Estimated time, disk space and memory of a plan.

    Attributes:
        throughputs: speed of each kind of run.
        hours: sequential time of all runs, or of rollout workers in cohorts, h.
        core_hours: core time, including learners, h.
        gpu_hours: GPU time, h.
        wall_hours: wall time on the nodes, h.
        how: phrase about the number of concurrent runs or cohorts, and about the nodes.
        bound: bottleneck of cohorts; None if runs learn alone.
        at_once: number of runs that the nodes hold at once.
        disk_gib: size of all results, GiB.
        checkpoint_gib: size of the checkpoints of the largest concurrent runs, GiB.
        memory_gib: memory of the largest concurrent runs, GiB.
    """

    throughputs: Mapping[SpeedKey, Throughput]
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
        """Describe the estimated core-hours, GPU-hours and duration in one line."""
        spent = f"{hours_text(self.core_hours)} core-hours"
        if self.gpu_hours:
            spent += f" and {hours_text(self.gpu_hours)} GPU-hours"
        return f"{spent}, {estimated_duration(self.wall_hours)} with {self.how} (an estimate)"

    def describe(self) -> str:
        """Describe the cost in a few lines."""
        unit = "a rollout worker on a core" if self.bound else "each run"
        speeds = [
            f"\n    {speed.label} {speed.training:,.0f}"
            + (f" (a full learner {speed.learner:,.0f})" if speed.learner else "")
            for speed in self.throughputs.values()
        ]
        return (
            f"cost: {self.summary()}\n"
            f"  speed of this machine, in steps/s of {unit}:{''.join(speeds)}\n"
            f"  disk: about {size_text(self.disk_gib)} of results, "
            f"and {size_text(self.checkpoint_gib)} of checkpoints of the runs under way\n"
            f"  memory: about {size_text(self.memory_gib)} for the runs under way"
        )


def estimate(
    plan: Plan,
    config: ExecutionConfig,
    speeds: Mapping[SpeedKey, Throughput] | None = None,
    find_speeds: SpeedFinder | None = None,
    nodes: Nodes | None = None,
) -> Cost:
    """Return the estimated cost of `plan`, neglecting the teachers' computing time.

    Args:
        plan: runs to estimate.
        config: configuration of their execution.
        speeds: known speeds, such as those of another `Cost`.
        find_speeds: function that returns the other speeds, by default `known_speeds`.
        nodes: nodes that execute the plan at the speed of this machine; None for this machine.
    """
    nodes = nodes or this_machine()
    counts: Counter[SpeedKey] = Counter()
    examples: dict[SpeedKey, RunSpec] = {}
    for spec in plan.runs:
        key = (*speed_key(spec), spec.schedule, len(spec.test_set))
        counts[key] += 1
        examples.setdefault(key, spec)
    resources = config.resources
    at_once = min(len(plan.runs), config.width or nodes.at_once(resources))
    by_speed = {speed_key(spec): spec for spec in examples.values()}
    missing = {key: spec for key, spec in by_speed.items() if key not in (speeds or {})}
    local = 1 if config.width else min(at_once, this_machine().at_once(resources))
    throughputs = {**(speeds or {}), **(find_speeds or known_speeds)(missing, config, local)}
    hours = learner_hours = disk = largest_buffer = 0.0
    for key, spec in examples.items():
        speed, schedule = throughputs[speed_key(spec)], spec.schedule
        # evaluations before the first step, after every interval, and after the last step
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
    how, bound = f"{at_once} {'run' if at_once == 1 else 'runs'} at once {nodes.where}", None
    if config.width:
        learners, cores = _learners_and_cores(config, nodes, len(plan.runs))
        gpus = learners * float(config.device != "cpu")
        times = {"learner": learner_hours / learners, "rollout workers' cores": hours / cores}
        bound, wall_hours = max(times.items(), key=lambda part: part[1])
        core_hours, gpu_hours = hours + wall_hours * learners, wall_hours * gpus
        (other,) = times.keys() - {bound}
        hardware = f"{sum(node.get('CPU', 0) for node in nodes.resources):g} cores"
        if gpus:
            hardware = f"{'one GPU' if learners == 1 else f'{learners} GPUs'} and {hardware}"
        how = (
            f"{'a cohort' if learners == 1 else f'{learners} cohorts'} of {config.width} runs on "
            f"{hardware} {nodes.where}, bound by the {bound}; the {other} would take "
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
        memory_gib=at_once * ((WORKER_BYTES if config.width else PROCESS_BYTES) + largest_buffer) / GIB,
    )


def _learners_and_cores(config: ExecutionConfig, nodes: Nodes, runs: int) -> tuple[int, float]:
    """Return the number of cohorts for `runs` runs on `nodes`, and of cores left for rollout workers."""
    worker = config.rollout_worker.cpus
    learners, free = 0, 0.0
    for node in nodes.resources:
        cores = node.get("CPU", 0.0)
        full = max(1, int(cores / (1 + config.width * worker)))
        count = full if config.device == "cpu" else int(node.get("GPU", 0.0))
        if count and cores:
            learners, free = learners + count, free + max(worker, cores - count)
    used = min(max(1, learners), math.ceil(runs / config.width))
    return used, max(worker, free * used / max(1, learners))


def quote(
    plan: Plan, results: str, config: ExecutionConfig, nodes: Nodes | None, *, whole: bool
) -> tuple[Cost | None, Cost | None]:
    """Return the cost of the plan (None unless `whole`) and its `long_cost`, both at the same speeds."""
    cost = estimate(plan, config, nodes=nodes) if whole else None
    return cost, long_cost(plan, results, config, cost.throughputs if cost else None, nodes)


def long_cost(
    plan: Plan,
    results: str,
    config: ExecutionConfig,
    speeds: Mapping[SpeedKey, Throughput] | None = None,
    nodes: Nodes | None = None,
) -> Cost | None:
    """Return the cost of the runs missing from `results`, or None if this machine runs them within an hour.

    See `estimate` for `speeds` and `nodes`.

    Raises:
        ResultsRootError: if the root belongs to something else or to another version.
    """
    slowest = estimate(plan, config, find_speeds=lambda examples, *_: dict.fromkeys(examples, SLOWEST))
    if slowest.wall_hours <= LONGEST_HOURS:
        return None
    left = unfinished(plan, results)
    if not left.runs:
        return None
    cost = estimate(left, config, speeds)
    if cost.wall_hours <= LONGEST_HOURS:
        return None
    return estimate(left, config, cost.throughputs, nodes=nodes) if nodes else cost


def unfinished(plan: Plan, results: str) -> Plan:
    """Return `plan` without the runs already done in the root `results`; see `check_usable` for errors."""
    store = Store.open(results)
    check_usable(store)
    try:
        done = {record.run.run_id for record in Results(store).runs() if record.status is RunStatus.DONE}
    except ResultsRootError:  # there is no root yet
        return plan
    return replace(plan, runs=tuple(spec for spec in plan.runs if spec.run_id not in done))


def _main() -> None:
    """Measure the runs given on standard input, and write their speeds to standard output as JSON."""
    contents_of_specs, config, files, search_path = pickle.load(sys.stdin.buffer)
    sys.path[:] = dict.fromkeys((*sys.path, *search_path))
    provide(files)
    speeds = []
    for spec in map(RunSpec.from_dict, contents_of_specs):
        import_plugins(spec, *REGISTRIES)
        speeds.append(asdict(measure(spec, config)))
    json.dump(speeds, sys.stdout)


if __name__ == "__main__":
    _main()
