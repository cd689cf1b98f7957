"""Speeds of kinds of runs: remembered, measured, or as shipped where neither is to be had in time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from tma_ray.campaign.costs.cohort_speed import LEARNERS
from tma_ray.campaign.costs.measuring import measure_all
from tma_ray.campaign.costs.memory import remember, remembered, speed_key
from tma_ray.campaign.costs.speed import Source, Throughput, label_of
from tma_ray.campaign.settings import Settings
from tma_ray.runs.placement import is_available
from tma_ray.runs.spec import RunSpec

PATIENCE_SECONDS = 6.0
"""Time of a measurement after which a shipped speed has to do, s."""

Kind = tuple[Any, ...]
"""What speed depends on: environment with its options, and student."""


class KnownSpeed(NamedTuple):
    """Steps per second of a student on one core, of training and of evaluations, and the versions of that."""

    training: float
    playing: float
    algorithm_version: int
    physics_version: int


class KnownPlayer(NamedTuple):
    """Steps per second of a player on one core, of its evaluations, and that a learner on a core feeds."""

    training: float
    playing: float
    learner: float
    algorithm_version: int
    physics_version: int


KNOWN_PLAYERS = {
    "ppo": KnownPlayer(30_000, 20_000, 11_000, algorithm_version=1, physics_version=3),
    "sac": KnownPlayer(30_000, 20_000, 120, algorithm_version=1, physics_version=3),
}
"""Likewise of students in cohorts, as `cohort_speed.measure_cohort` found them."""

KNOWN = {
    "ppo": KnownSpeed(training=8_000, playing=20_000, algorithm_version=1, physics_version=3),
    "sac": KnownSpeed(training=150, playing=20_000, algorithm_version=1, physics_version=3),
}
"""Speeds of students with their default hyper-parameters, as `speed.measure` found them on an AMD EPYC; they
are used while the versions that they were measured at are current."""


def kind_of(spec: RunSpec) -> Kind:
    """Returns the kind of a run."""
    return (
        spec.environment,
        repr(sorted(spec.environment_options.items())),
        repr(sorted(spec.inputs.items())),
        spec.student,
    )


def measured_speeds(
    examples: Mapping[Kind, RunSpec], settings: Settings, at_once: int
) -> dict[Kind, Throughput]:
    """Returns the speed of each kind here, measured now unless that was done before.

    Takes some seconds. A kind that takes longer, since its kernels are compiled first, has its shipped speed.

    Args:
        examples: a run of each kind.
        settings: how they are executed.
        at_once: how many run at the same time.

    Raises:
        ValueError: a kind of run fails.
    """
    return _speeds(examples, settings, at_once, PATIENCE_SECONDS)


def patient_speeds(
    examples: Mapping[Kind, RunSpec], settings: Settings, at_once: int
) -> dict[Kind, Throughput]:
    """Returns the same, waiting until all kernels are compiled; see `measured_speeds`."""
    return _speeds(examples, settings, at_once, math.inf)


def quick_speeds(
    examples: Mapping[Kind, RunSpec], settings: Settings, at_once: int
) -> dict[Kind, Throughput]:
    """Returns the same without measuring kinds that have a shipped speed; see `measured_speeds`."""
    return _speeds(examples, settings, at_once, 0.0)


def shipped_speed(spec: RunSpec, settings: Settings) -> Throughput | None:
    """Returns the throughput of runs like `spec` as `KNOWN` has it, None if that says nothing of them."""
    if settings.width:
        return _shipped_cohort(spec, settings)
    known = KNOWN.get(spec.student)
    current = (spec.algorithm_versions.get("student"), spec.physics_version)
    if known is None or settings.device != "cpu" or current != known[2:] or "environment" in spec.plugins:
        return None
    return Throughput(label_of(spec), known.training, known.playing, 0, Source.SHIPPED)


def _shipped_cohort(spec: RunSpec, settings: Settings) -> Throughput | None:
    """Returns the same of runs in a cohort: players are as fast on any device."""
    known, gpu = KNOWN_PLAYERS.get(spec.student), settings.device != "cpu"
    current = (spec.algorithm_versions.get("student"), spec.physics_version)
    if known is None or current != known[3:] or "environment" in spec.plugins:
        return None
    precision = str(spec.student_hyperparameters.get("matmul_precision", "highest"))
    learner = LEARNERS.get((spec.student, precision)) if gpu else known.learner
    if learner is None:
        return None
    return Throughput(label_of(spec), known.training, known.playing, 0, Source.SHIPPED, learner=learner)


def _speeds(
    examples: Mapping[Kind, RunSpec], settings: Settings, at_once: int, patience: float
) -> dict[Kind, Throughput]:
    if not settings.width and not is_available(
        settings.device
    ):  # as where a campaign is sent to a cluster with GPUs
        settings = replace(settings, device="cpu", resources=replace(settings.resources, gpus=0))
    keys = {kind: speed_key(spec, settings, at_once) for kind, spec in examples.items()}
    before = remembered()
    shipped = {kind: shipped_speed(spec, settings) for kind, spec in examples.items()}
    due = {
        key: examples[kind]
        for kind, key in keys.items()
        if key not in before and (patience > 0 or shipped[kind] is None)
    }
    limits = {key: patience for kind, key in keys.items() if shipped[kind] is not None}
    measured = measure_all(due, settings, at_once, limits)
    if measured:
        remember(measured)
    speeds = before | measured
    found = {kind: speeds.get(key, shipped[kind]) for kind, key in keys.items()}
    return {kind: speed for kind, speed in found.items() if speed is not None}
