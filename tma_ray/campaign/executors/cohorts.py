"""Cohorts on Ray: learners and the runs in their slots."""

import logging
import math
import time
from collections import Counter, deque
from collections.abc import Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import ray
from ray.exceptions import ActorUnavailableError, RayError

from tma_ray.campaign.cluster.nodes import resource_text
from tma_ray.campaign.cluster.protocols import Head
from tma_ray.campaign.cluster.ray_private import living_nodes
from tma_ray.campaign.executors.actors import LearnerActor, reason_for_loss
from tma_ray.campaign.settings import GIB, ExecutionConfig, Resources
from tma_ray.results import LearnerProgress
from tma_ray.runs.inputs import import_plugins, new_environment
from tma_ray.runs.spec import RunSpec
from tma_ray.students import COHORT_STUDENTS, Learner
from tma_ray.students.base import checked_spaces
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.support.component_names import base_name


class StackKey(NamedTuple):
    """Properties that runs must share for a learner to train them in one batch (stack)."""

    student: str
    observation: int
    action: int
    hyperparameters: str


def stack_keys(specs: Sequence[RunSpec]) -> dict[str, StackKey]:
    """Return the stack key of each run by run id, constructing every environment once.

    Raises:
        ValueError: if a student cannot learn in a cohort, or does not support the spaces.
    """
    sizes: dict[Hashable, tuple[int, int]] = {}
    keys = {}
    for spec in specs:
        student = base_name(spec.student)
        if student not in COHORT_STUDENTS:
            raise ValueError(
                f"student {spec.student!r} cannot learn in a cohort, as {' and '.join(COHORT_STUDENTS)} can: "
                f"add '--cohort off', with '--gpus-per-run' on a GPU"
            )
        recipe = spec.environment, repr(sorted(spec.environment_options.items())), *spec.inputs.items()
        if recipe not in sizes:
            import_plugins(spec, "environment")
            environment = new_environment(spec)
            observations, actions = checked_spaces(environment.observation_space, environment.action_space)
            environment.close()
            sizes[recipe] = observations.shape[0], actions.shape[0]
        values = repr(sorted(spec.student_hyperparameters.items()))
        keys[spec.run_id] = StackKey(student, *sizes[recipe], values)
    return keys


PROCESS_GIB = {"cpu": 1.0, "cuda": 4.0}  # memory of a learner's process without its replay buffers, GiB
ROW_BYTES = 4.2  # bytes per number stored for a transition, each observation being stored only once


def learner_resources(
    settings: ExecutionConfig, specs: Iterable[RunSpec], keys: Mapping[str, StackKey]
) -> Resources:
    """Return the resources that the learner of a full cohort of `specs` needs; learners do not share GPUs."""
    replays = []
    for spec in specs:
        rows = min(int(spec.student_hyperparameters.get("buffer_size", 0)), spec.schedule.steps)
        key = keys[spec.run_id]
        replays.append(ROW_BYTES * rows * (key.observation + key.action + 2))
    device = settings.device.partition(":")[0]
    copies = 1 if device == "cuda" else 2  # in memory: for the checkpoint and, on a CPU, in the learner
    replay = copies * settings.width * max(replays, default=0.0) / GIB
    return Resources(1.0, float(device == "cuda"), PROCESS_GIB[device] + replay)


def room_of(node: Mapping[str, float], settings: ExecutionConfig, learner: Resources) -> tuple[int, int]:
    """Return the number of learners that fit on a node, and of rollout workers beside each learner."""
    worker = settings.rollout_worker
    whole = Resources(
        learner.cpus + settings.width * worker.cpus,
        memory_gib=learner.memory_gib + settings.width * worker.memory_gib,
    )
    least = Resources(learner.cpus + worker.cpus, learner.gpus, learner.memory_gib + worker.memory_gib)
    learners = least.fit_into(node)
    if not learner.gpus:
        learners = min(learners, max(1, whole.fit_into(node)))
    if not learners:
        return 0, 0
    cores = node.get("CPU", 0.0) / learners - learner.cpus
    memory = node.get("memory", 0.0) / learners / GIB - learner.memory_gib
    by_memory = memory / worker.memory_gib if worker.memory_gib else math.inf
    return learners, int(min(settings.width, cores / worker.cpus + 1e-9, by_memory + 1e-9))


def check_room(settings: ExecutionConfig, specs: Sequence[RunSpec], keys: Mapping[str, StackKey]) -> None:
    """Check that a learner and a run fit on some node; otherwise Ray would queue them forever.

    Raises:
        ValueError: if they fit on no node.
    """
    learner = learner_resources(settings, specs, keys)
    nodes = [node["Resources"] for node in living_nodes()]
    if any(room_of(node, settings, learner)[1] for node in nodes):
        return
    raise ValueError(
        f"no node can hold the learner of a cohort, of {learner.cpus:g} CPUs, {learner.gpus:g} GPUs and "
        f"{learner.memory_gib:.1f} GiB, and a run of {settings.rollout_worker.cpus:g} CPUs and "
        f"{settings.rollout_worker.memory_gib:g} GiB beside it: the nodes have {resource_text(nodes)}; give "
        f"'--cohort off' or a smaller number, add larger nodes, or give '--autoscaling' if the cluster adds "
        f"them"
    )


AUTOSCALING_LEARNERS = 4  # largest number of learners that wait for new nodes of an autoscaling cluster

LONGEST_INTERVAL = 5.0
"""Longest interval between two polls that counts as a learner's silence, s: the driver may have slept."""

logger = logging.getLogger(__name__)


@dataclass
class _Cohort:
    """Learner of a cohort, with the runs in its slots."""

    actor: Any
    node: str
    width: int
    max_runs: int
    opened: Any
    ended: Any
    learner: Learner | None = None
    runs: dict[str, StackKey] = field(default_factory=dict)
    report: Any = None
    progress: LearnerProgress | None = None
    silent_since: float | None = None
    unanswered: float = 0.0
    polled_at: float = field(default_factory=time.monotonic)

    def choose(self, waiting: Sequence[RunSpec], keys: Mapping[str, StackKey]) -> int | None:
        """Return the index of the run to start next, preferably one of an existing stack, or None."""
        if len(self.runs) >= self.max_runs:
            return None
        counts, new = Counter(self.runs.values()), None
        for index, spec in enumerate(waiting):
            key = keys[spec.run_id]
            if 0 < counts[key] < self.width:
                return index
            if new is None and not counts[key]:
                new = index
        return new


class Cohorts:
    """Manager of cohorts: learners, one per GPU or per `width` runs on CPUs, and the runs of each.

    A lost learner is replaced, and its runs continue with another. If memory runs out, later learners have
    half as many slots.
    """

    def __init__(
        self,
        settings: ExecutionConfig,
        head: Head,
        specs: Sequence[RunSpec],
        keys: Mapping[str, StackKey],
        learner_type: type[LearnerActor] = LearnerActor,
    ) -> None:
        self._settings, self._head, self._type = settings, head, learner_type
        self._specs, self._keys = specs, keys
        self._cohorts: list[_Cohort] = []
        self._blameless: set[str] = set()
        self._resources: Resources = learner_resources(settings, specs, keys)
        self._compiled = compilation(specs) if self._resources.gpus else False

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Remove and return a run of `waiting` for which a learner has a slot, or return None."""
        for cohort in self._cohorts:
            index = None if cohort.learner is None else cohort.choose(waiting, self._keys)
            if index is not None:
                spec = waiting[index]
                del waiting[index]
                cohort.runs[spec.run_id] = self._keys[spec.run_id]
                return spec
        self._grow(len(waiting))
        return None

    def learner_of(self, run_id: str) -> tuple[Learner | None, str]:
        """Return the learner of a run that `take` returned, and the Ray id of the learner's node."""
        return next((cohort.learner, cohort.node) for cohort in self._cohorts if run_id in cohort.runs)

    def leave(self, run_id: str) -> None:
        """Free the slot of a run that has ended."""
        self._blameless.discard(run_id)
        for cohort in self._cohorts:
            cohort.runs.pop(run_id, None)

    def lost_without_fault(self, run_id: str) -> bool:
        """Return True if this run's learner ran out of memory."""
        return run_id in self._blameless

    def update(self, *, over: bool) -> Sequence[LearnerProgress]:
        """End lost learners (and idle ones if `over`), and poll and return the progress of all others."""
        for cohort in list(self._cohorts):
            if not self._lives(cohort) or (over and not cohort.runs):
                self._end(cohort)
                continue
            if cohort.learner is None and _is_ready(cohort.opened):
                with suppress(RayError, MemoryError):  # handled in `_lives`, since `serve` raises it too
                    cohort.learner, node_id = ray.get(cohort.opened)
                    for node in self._head.nodes() if not cohort.node else ():
                        if node["NodeID"] == node_id:
                            cohort.max_runs = room_of(node["Resources"], self._settings, self._resources)[1]
                    cohort.node = node_id
            self._poll(cohort)
        return [cohort.progress for cohort in self._cohorts if cohort.progress is not None]

    def close(self) -> None:
        """End all learners."""
        for cohort in list(self._cohorts):
            self._end(cohort)

    def _grow(self, waiting: int) -> None:
        """Start learners for waiting runs as long as nodes have room."""
        free = sum(cohort.max_runs - len(cohort.runs) for cohort in self._cohorts if cohort.learner is None)
        while waiting > free:
            room = self._free_node()
            if room is None:
                return
            node, max_runs = room
            width = self._settings.width
            cohort_settings = CohortSettings(self._settings.device, width, self._compiled)
            actor = self._type.launch(cohort_settings, self._resources, node)
            opened, ended = actor.open.remote(), actor.serve.remote()
            self._cohorts.append(_Cohort(actor, node, width, max_runs, opened, ended))
            free += max_runs

    def _free_node(self) -> tuple[str, int] | None:
        """Return a node for a learner ("" for a future one) and the number of runs beside it, or None."""
        taken = Counter(cohort.node for cohort in self._cohorts)
        for node in self._head.nodes():
            learners, workers = room_of(node["Resources"], self._settings, self._resources)
            if taken[node["NodeID"]] < learners and workers:
                return node["NodeID"], workers
        if self._settings.autoscaling and taken[""] < AUTOSCALING_LEARNERS:
            return "", self._settings.width
        return None

    def _poll(self, cohort: _Cohort) -> None:
        now = time.monotonic()
        passed, cohort.polled_at = min(now - cohort.polled_at, LONGEST_INTERVAL), now
        if cohort.report is not None:
            if not _is_ready(cohort.report):
                cohort.unanswered += passed if cohort.learner is not None else 0.0
                return
            with suppress(RayError):
                cohort.progress = ray.get(cohort.report)
                cohort.silent_since, cohort.unanswered = None, 0.0
        cohort.report = cohort.actor.report.remote()

    def _lives(self, cohort: _Cohort) -> bool:
        """Return False, after logging the reason, if a learner has ended or has been silent for too long."""
        if not _is_ready(cohort.ended):
            if cohort.unanswered < self._settings.unreachable_seconds:
                return True
            logger.warning(
                "the learner of a cohort on %s has not answered for %.0f s: it is killed, and its %d runs "
                "resume from their checkpoints beside another",
                cohort.progress.host if cohort.progress else "its node",
                cohort.unanswered,
                len(cohort.runs),
            )
            return False
        try:
            ray.get(cohort.ended)
        except MemoryError as error:
            self._narrow(cohort, error)
        except RayError as error:
            if isinstance(error, ActorUnavailableError):
                cohort.silent_since = cohort.silent_since or time.monotonic()
                if time.monotonic() - cohort.silent_since < self._settings.unreachable_seconds:
                    cohort.ended, cohort.report = cohort.actor.serve.remote(), None
                    return True
            _warn(cohort, error)
        return False

    def _narrow(self, cohort: _Cohort, error: MemoryError) -> None:
        """Halve the width of future learners after one ran out of memory."""
        if cohort.width == 1:
            _warn(cohort, error)
            return
        self._blameless |= set(cohort.runs)
        width = min(self._settings.width, cohort.width // 2)
        self._settings = replace(self._settings, cohort=width)
        self._resources = learner_resources(self._settings, self._specs, self._keys)
        logger.warning(
            "too little memory for a cohort of %d runs (%s): from now on cohorts have %d slots; the %d runs "
            "resume from their checkpoints, soundly, but not bit for bit as with the other width",
            cohort.width,
            reason_for_loss(error),
            width,
            len(cohort.runs),
        )

    def _end(self, cohort: _Cohort) -> None:
        self._cohorts.remove(cohort)
        ray.kill(cohort.actor)


def compilation(specs: Sequence[RunSpec]) -> bool | str:
    """Return the compilation mode of updates on a GPU, with autotuning if all matrix products use bfloat16.

    Autotuning takes minutes at the start and, with bfloat16, doubles the speed. It chooses kernels by their
    measured time, so rounding depends on the machine and its cache; smaller gains would not justify that.
    """
    medium = all(spec.student_hyperparameters.get("matmul_precision") == "medium" for spec in specs)
    return True if medium else "default"


def _is_ready(reference: Any) -> bool:
    ready, _ = ray.wait([reference], timeout=0)
    return bool(ready)


def _warn(cohort: _Cohort, error: Exception) -> None:
    logger.warning(
        "the learner of a cohort was lost, and %d runs resume from their checkpoints: %s",
        len(cohort.runs),
        reason_for_loss(error),
    )
