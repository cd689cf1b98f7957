"""Cost of a plan before anything runs: speeds, hours, disk and memory; confirmation of what takes long.

Speeds are those of a table, scaled to this machine; others are measured. ``python -m tma_ray.campaign.costs``
measures in a process of its own and prints a line of JSON after each compilation and for each kind of run.
"""

import csv
import json
import math
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from statistics import mean
from typing import Any, Final

import numpy as np
from rich.progress import Progress

from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import GIB, Nodes, Settings, this_machine
from tma_ray.console.terminal import terminal
from tma_ray.embodiments import embodiment_names
from tma_ray.envs import make_environment
from tma_ray.results import Results, ResultsRootError, RunStatus, Store, check_usable
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.inputs import REGISTRIES, arguments, contents, import_plugins, provide
from tma_ray.runs.placement import is_available
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Transition, make_student
from tma_ray.support.component_names import base_name
from tma_ray.support.jit import count_compiled
from tma_ray.support.texts import counted

Kind = tuple[Any, ...]
"""Kind of run, on which speed depends: environment with its options and files, and student."""

DEFAULT_BODY: Final = "classic_bipedal"  # body whose row serves students that were measured on no other
REFERENCE_ROUNDS: Final = 247.0  # speed of the machine of the table, in rounds of `machine_speed` per second

LEARNERS: Final = {
    ("ppo", "cpu", "highest"): 11_000.0,
    ("sac", "cpu", "highest"): 120.0,
    ("sac", "cuda", "highest"): 41_500.0,
    ("sac", "cuda", "high"): 63_700.0,
    ("sac", "cuda", "medium"): 72_900.0,
    ("ppo", "cuda", "highest"): 152_000.0,
}
"""Environment steps per second that a full learner of 48 slots feeds, by student, device and precision, with
updates that are not compiled: one core of the machine of the table, or an H100
(benchmarks/measured/2026-11.md)."""

PLAYER: Final = 30_000.0, 20_000.0
"""Steps per second of a player of a cohort on one core of that machine, in training and in evaluations."""

MEASURED_SECONDS = 0.6
"""Shortest measurement, s; half of it is trained before, so that nothing is compiled or loaded in it."""

MACHINE_SECONDS: Final = 0.4  # time of the measurement of this machine, s

SMALLER: Final = {"exploration_steps": 1_000, "learning_starts": 1_000, "buffer_size": 50_000}
"""Hyper-parameters of students, with the largest values that a measurement leaves them."""

CHUNKS: Final = ("steps_per_update", "n_steps", "train_freq")
"""Hyper-parameters with the number of steps between updates, which are measured whole."""

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
"""Script of the measurement of a machine: layers of a network, and interpreted steps."""


@dataclass(frozen=True)
class Throughput:
    """Speed of one kind of run.

    Attributes:
        label: student, environment and body.
        training: environment steps per second of training; in a cohort of a player that never waits.
        playing: environment steps per second of an evaluation.
        transition_bytes: size of one transition in a replay buffer.
        learner: environment steps per second that a full cohort's learner feeds; 0 of runs that learn alone.
    """

    label: str
    training: float
    playing: float
    transition_bytes: int
    learner: float = 0.0


SpeedFinder = Callable[[Mapping[Kind, RunSpec], Settings, int], Mapping[Kind, Throughput]]
"""Return the speeds of kinds of runs, from an example of each, settings, and the number of runs at once."""


def kind_of(spec: RunSpec) -> Kind:
    """Return the kind of a run."""
    options, inputs = sorted(spec.environment_options.items()), sorted(spec.inputs.items())
    return spec.environment, repr(options), repr(inputs), spec.student


def label_of(spec: RunSpec) -> str:
    """Return student, environment and body of a run, as costs show them."""
    return f"{spec.student} on {spec.environment} {spec.embodiment}".strip()


def known_speeds(
    examples: Mapping[Kind, RunSpec], settings: Settings, at_once: int
) -> Mapping[Kind, Throughput]:
    """Return the speeds of kinds of runs here: those of the table, scaled to this machine, others measured.

    Raises:
        ValueError: a kind of run fails.
    """
    elsewhere = not settings.width and settings.device != "cpu" and is_available(settings.device)
    listed: dict[Kind, Throughput] = {}
    for kind, spec in examples.items():
        body = base_name(spec.embodiment)
        if elsewhere or "environment" in spec.plugins or body not in embodiment_names():
            continue  # the table says nothing of it
        student = base_name(spec.student) if settings.width else spec.student
        row = _table().get((student, body)) or _table().get((student, DEFAULT_BODY))
        if row is not None:
            scale = machine_speed(at_once) / REFERENCE_ROUNDS
            each = _shared(replace(row, label=label_of(spec)), spec, settings)
            learner = each.learner * (scale if settings.device == "cpu" else 1.0)
            speeds = scale * each.training, scale * each.playing, each.transition_bytes, learner
            listed[kind] = Throughput(each.label, *speeds)
    missing = {kind: spec for kind, spec in examples.items() if kind not in listed}
    return listed | measured_speeds(missing, settings)


def measured_speeds(
    examples: Mapping[Kind, RunSpec],
    settings: Settings,
    at_once: int = 1,  # noqa: ARG001  # as of a `SpeedFinder`
) -> dict[Kind, Throughput]:
    """Return the speeds of kinds of runs, measured here one after the other; of cohorts see `LEARNERS`.

    Each takes some seconds, and half a minute where kernels are compiled first. The measurement has a process
    of its own, which leaves nothing of torch or a GPU in this one.

    Raises:
        ValueError: a kind of run fails; the message has the end of its error.
    """
    if not examples:
        return {}
    given = settings
    if settings.width or not is_available(settings.device):  # as where a campaign is sent to a cluster
        settings = replace(settings, device="cpu", cohort=0, resources=replace(settings.resources, gpus=0))
    specs = list(examples.values())
    order = pickle.dumps(([spec.to_dict() for spec in specs], settings, contents(specs), sys.path))
    found: list[Throughput] = []
    with tempfile.TemporaryFile() as errors, _progress(len(specs)) as show:
        with subprocess.Popen(
            [sys.executable, "-m", "tma_ray.campaign.costs"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            with process.stdin as stream:
                stream.write(order)
            compiled = kernels = 0
            for record in map(json.loads, process.stdout):
                if "kernels" in record:
                    compiled, kernels = record["compiled"], record["kernels"]
                else:
                    found.append(Throughput(**record))
                show(compiled + len(found), kernels + len(specs))
        if process.returncode:
            errors.seek(0)
            *_, error = ["it was ended", *errors.read().decode(errors="replace").strip().splitlines()]
            raise ValueError(f"cannot measure the speed of {', '.join(map(label_of, specs))}: {error}")
    speeds = zip(examples.items(), found, strict=True)
    return {kind: _shared(each, spec, given) for (kind, spec), each in speeds}


@cache
def machine_speed(at_once: int) -> float:
    """Return the speed of a core while all are busy, in rounds of `ROUNDS` per second."""
    started = [
        subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", ROUNDS, str(MACHINE_SECONDS)],
            stdout=subprocess.PIPE,
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        for _ in range(at_once)
    ]
    return mean(float(process.communicate()[0]) for process in started)


def measure(spec: RunSpec, settings: Settings) -> Throughput:
    """Return the speed of runs like `spec` here, on one task, without a teacher; take about two seconds.

    Time is that of the processor, which other processes slow down only as far as they share its caches and
    the halves of its cores; with a GPU it is that of the wall.
    """
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    observations, actions = environment.observation_space, environment.action_space
    values, threads = arguments(spec, "student"), settings.resources.threads
    values |= {name: min(values[name], most) for name, most in SMALLER.items() if name in values}
    if "updates" in values:
        values["updates"] = "interleaved"  # a measurement is shorter than what a long episode may owe
    parts = base_name(spec.student), observations, actions, np.random.SeedSequence(0), values
    student = make_student(*parts, settings.device, threads)
    chunk = next((int(values[name]) for name in CHUNKS if isinstance(values.get(name), int)), 100)
    options = {"task": spec.task_space.centre}
    observation = environment.reset(seed=0, options=options)[0]

    def clock() -> float:
        return time.process_time() / threads if settings.device == "cpu" else time.perf_counter()

    def train(steps: int) -> None:
        nonlocal observation
        for _ in range(steps):
            action = student.act(observation)
            following, reward, terminated, truncated, _ = environment.step(action)
            student.observe(Transition(observation, action, float(reward), following, terminated, truncated))
            ended = terminated or truncated
            observation = environment.reset(options=options)[0] if ended else following

    def speed(seconds: float) -> float:
        began, steps = clock(), 0
        while (spent := clock() - began) < seconds:
            train(chunk)
            steps += chunk
        return steps / spent

    train(SMALLER["learning_starts"])
    speed(MEASURED_SECONDS / 2)
    training = speed(MEASURED_SECONDS)
    environment.close()
    playing = 0.0
    for tasks in (spec.test_set.tasks[:1], spec.test_set.tasks[::10]):  # compiled by the first
        evaluation = Evaluation(replace(spec, test_set=replace(spec.test_set, tasks=tasks)))
        began = clock()
        steps = sum(row["length"] for row in evaluation(student.act_greedily))
        playing = steps / (clock() - began)
        evaluation.close()
    numbers = math.prod(observations.shape or ()) + math.prod(actions.shape or ()) + 2
    return Throughput(label_of(spec), training, playing, 4 * numbers)


@cache
def _table() -> Mapping[tuple[str, str], Throughput]:
    """Return the speeds of students on one core, by student and body.

    Steps of ``ppo:preset=decisive`` take 1.03 times as long as those of ``ppo`` (``docs/pilot.md``).
    """
    text = resources.files("tma_ray.campaign").joinpath("speeds.csv").read_text()
    return {
        (row["student"], row["embodiment"]): Throughput(
            "", float(row["training"]), float(row["playing"]), int(row["transition_bytes"])
        )
        for row in csv.DictReader(text.splitlines())
    }


def _shared(alone: Throughput, spec: RunSpec, settings: Settings) -> Throughput:
    """Return the speed of a run in a cohort, where `settings` ask for them; else `alone`."""
    if not settings.width:
        return alone
    student, device = base_name(spec.student), settings.device.partition(":")[0]
    precision = str(spec.student_hyperparameters.get("matmul_precision"))
    learner = LEARNERS.get((student, device, precision), LEARNERS[student, device, "highest"])
    return replace(alone, training=PLAYER[0], playing=PLAYER[1], learner=learner)


@contextmanager
def _progress(kinds: int) -> Iterator[Callable[[int, int], None]]:
    """Context manager of a bar of what is done on the error stream, or a line without a terminal."""
    text = f"measuring the speed of {counted(kinds, 'kind of run', 'kinds of runs')}"
    console = terminal(stderr=True)
    if not console.is_terminal:
        console.print(f"{text}, some seconds", highlight=False)
        yield lambda *_: None
        return
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(text, total=kinds)
        yield lambda done, total: progress.update(task, completed=done, total=total)


TEST_STEPS = 1_000  # environment steps of a test task: half of the most there can be

START_SECONDS = 8.0
"""Time of one core for a run's processes before the first step and after the last, s (measured)."""

RUN_BYTES = 600_000  # size on disk of a run's policy and tables with hardly a row (measured)

EVALUATION_BYTES, PROBE_BYTES, STEP_BYTES = 12, 8, 0.04
"""Size on disk of each test task played, each task probed and each training step (an episode has some 20)."""

PROCESS_BYTES, PLAYER_BYTES = 0.9 * GIB, 0.5 * GIB
"""Memory of a run's processes without a replay buffer (measured): alone with its teacher, and in a cohort."""

NETWORK_BYTES = 5e6  # size of a run's two checkpoints without a replay buffer (measured)

BUFFER_SHARE = 1.3
"""Bytes of the checkpoints over those of the replay buffer: parts of the one before are kept (measured)."""

LONGEST_HOURS = 1.0  # longest time on this machine that needs no confirmation, h

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
        """Return the estimated time that it takes."""
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
    """Return the estimated cost of `plan` at the speeds of this machine, which executes it without `nodes`.

    Teachers are left out, which cost milliseconds an episode. `known` has speeds of another `Cost`; others
    are found by `find_speeds`, `known_speeds` by default.
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
    kinds = {kind_of(spec): spec for spec in examples.values()}
    missing = {kind: spec for kind, spec in kinds.items() if kind not in (known or {})}
    here = 1 if settings.width else min(at_once, this_machine().at_once(resources))
    throughputs = {**(known or {}), **(find_speeds or known_speeds)(missing, settings, here)}
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
    left = unfinished(plan, results)
    if not left.runs:
        return None
    cost = estimate(left, settings, known)
    if cost.wall_hours <= LONGEST_HOURS:
        return None
    return estimate(left, settings, cost.throughputs, nodes=nodes) if nodes else cost


def unfinished(plan: Plan, results: str) -> Plan:
    """Return a plan of the runs that are not done in a results root; see `check_usable` for errors."""
    store = Store.open(results)
    check_usable(store)
    try:
        done = {each.run.run_id for each in Results(store).runs() if each.status is RunStatus.DONE}
    except ResultsRootError:  # nothing is there yet
        return plan
    return replace(plan, runs=tuple(spec for spec in plan.runs if spec.run_id not in done))


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


def _main() -> None:
    """Measure the runs named on the standard input, one after the other."""
    specs, settings, files, search_path = pickle.load(sys.stdin.buffer)
    sys.path[:] = dict.fromkeys((*sys.path, *search_path))
    provide(files)

    def send(record: Mapping[str, Any]) -> None:
        sys.stdout.write(json.dumps(record) + "\n")
        sys.stdout.flush()

    count_compiled(lambda compiled, kernels: send({"compiled": compiled, "kernels": kernels}))
    for content in specs:
        spec = RunSpec.from_dict(content)
        import_plugins(spec, *REGISTRIES)
        send(asdict(measure(spec, settings)))


if __name__ == "__main__":
    _main()
