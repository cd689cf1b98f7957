"""Speeds of runs: a table of measured ones, scaled to this machine, and measurements of others.

``python -m tma_ray.campaign.speeds`` measures in a process of its own and prints a line of JSON after each
compilation and for each kind of run.
"""

from __future__ import annotations

import csv
import json
import math
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from statistics import mean
from typing import Any, Final

import numpy as np
from rich.progress import Progress

from tma_ray.campaign.settings import Settings
from tma_ray.commands.texts import counted
from tma_ray.embodiments import embodiment_names
from tma_ray.envs import make_environment
from tma_ray.jit import count_compiled
from tma_ray.part_names import base_name
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.inputs import REGISTRIES, arguments, contents, import_plugins, provide
from tma_ray.runs.placement import is_available
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Transition, make_student
from tma_ray.terminal import terminal

Kind = tuple[Any, ...]
"""Kind of run, on which speed depends: environment with its options and files, and student."""

DEFAULT_BODY: Final = "classic_bipedal"
"""Body whose row serves students that were measured on no other."""

REFERENCE_ROUNDS: Final = 247.0
"""Speed of the machine of the table, in rounds of `machine_speed` per second."""

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

MACHINE_SECONDS: Final = 0.4
"""Time of the measurement of this machine, s."""

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
        student, body = spec.student, base_name(spec.embodiment)
        if elsewhere or "environment" in spec.plugins or body not in embodiment_names():
            continue  # the table says nothing of it
        student = base_name(student) if settings.width else student
        row = _table().get((student, body)) or _table().get((student, DEFAULT_BODY))
        if row is not None:
            scale = machine_speed(at_once) / REFERENCE_ROUNDS
            each = _shared(replace(row, label=label_of(spec)), spec, settings)
            learner = each.learner * (scale if settings.device == "cpu" else 1.0)
            listed[kind] = replace(
                each, training=scale * each.training, playing=scale * each.playing, learner=learner
            )
    missing = {kind: spec for kind, spec in examples.items() if kind not in listed}
    return {**listed, **measured_speeds(missing, settings)}


def measured_speeds(
    examples: Mapping[Kind, RunSpec],
    settings: Settings,
    at_once: int = 1,  # noqa: ARG001  # as of a `SpeedFinder`
) -> Mapping[Kind, Throughput]:
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
            [sys.executable, "-m", "tma_ray.campaign.speeds"],
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
    """Return the speed of one of several busy cores, in rounds of `ROUNDS` per second, within a second."""
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
        steps = sum(row["length"] for row in evaluation(student))
        playing = steps / (clock() - began)
        evaluation.close()
    numbers = math.prod(observations.shape or ()) + math.prod(actions.shape or ()) + 2
    return Throughput(label_of(spec), training, playing, 4 * numbers)


@cache
def _table() -> Mapping[tuple[str, str], Throughput]:
    """Return the speeds of students with their default hyper-parameters on one core, by student and body."""
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


def _main() -> None:
    """Measure the runs that the standard input names, each after the other."""
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
