"""Cohorts on Ray: their learners, and the runs that learn with each."""

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

from tma_ray.campaign.cluster.base import Head, living_nodes, offers
from tma_ray.campaign.executors.actors import LearnerActor, reason_for_loss
from tma_ray.campaign.settings import GIB, Resources, Settings
from tma_ray.envs import make_environment
from tma_ray.results import LearnerProgress
from tma_ray.runs.inputs import arguments, import_plugins
from tma_ray.runs.spec import RunSpec
from tma_ray.students import COHORT_STUDENTS, Learner
from tma_ray.students.base import checked_spaces
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.support.component_names import base_name


class Kind(NamedTuple):
    """Kind of runs that a stacked learner can hold together: algorithm, sizes and settings."""

    student: str
    observation: int
    action: int
    hyperparameters: str


def kinds_of(specs: Sequence[RunSpec]) -> dict[str, Kind]:
    """Return the kind of each run by its id; make every environment once.

    Raises:
        ValueError: a student that cannot learn in a cohort, or spaces that it does not take.
    """
    sizes: dict[Hashable, tuple[int, int]] = {}
    kinds = {}
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
            environment = make_environment(spec.environment, **arguments(spec, "environment"))
            observations, actions = checked_spaces(environment.observation_space, environment.action_space)
            environment.close()
            sizes[recipe] = observations.shape[0], actions.shape[0]
        kinds[spec.run_id] = Kind(student, *sizes[recipe], repr(sorted(spec.student_hyperparameters.items())))
    return kinds


PROCESS_GIB = {"cpu": 1.0, "cuda": 4.0}  # memory of a learner's process without replay, GiB
ROW_BYTES = 4.2  # size of a stored transition for each of its numbers, of which observations are stored once


def learner_resources(settings: Settings, specs: Iterable[RunSpec], kinds: Mapping[str, Kind]) -> Resources:
    """Return the resources of the learner of a full cohort of `specs`: on a GPU the whole GPU."""
    replays = []
    for spec in specs:
        rows = min(int(spec.student_hyperparameters.get("buffer_size", 0)), spec.schedule.steps)
        kind = kinds[spec.run_id]
        replays.append(ROW_BYTES * rows * (kind.observation + kind.action + 2))
    device = settings.device.partition(":")[0]
    copies = 1 if device == "cuda" else 2  # a checkpoint's, and the learner's own where that is no GPU's
    replay = copies * settings.width * max(replays, default=0.0) / GIB
    return Resources(1.0, float(device == "cuda"), PROCESS_GIB[device] + replay)


def room_of(node: Mapping[str, float], settings: Settings, learner: Resources) -> tuple[int, int]:
    """Return the numbers of learners that a node with these resources holds, and of players next to each."""
    player = settings.player
    whole = Resources(
        learner.cpus + settings.width * player.cpus,
        memory_gib=learner.memory_gib + settings.width * player.memory_gib,
    )
    least = Resources(learner.cpus + player.cpus, learner.gpus, learner.memory_gib + player.memory_gib)
    learners = least.fit_into(node)
    if not learner.gpus:
        learners = min(learners, max(1, whole.fit_into(node)))
    if not learners:
        return 0, 0
    cores = node.get("CPU", 0.0) / learners - learner.cpus
    memory = node.get("memory", 0.0) / learners / GIB - learner.memory_gib
    by_memory = memory / player.memory_gib if player.memory_gib else math.inf
    return learners, int(min(settings.width, cores / player.cpus + 1e-9, by_memory + 1e-9))


def check_room(settings: Settings, specs: Sequence[RunSpec], kinds: Mapping[str, Kind]) -> None:
    """Refuse cohorts that no node can hold: Ray would let them wait forever.

    Raises:
        ValueError: a learner and a run need more than any node has.
    """
    learner = learner_resources(settings, specs, kinds)
    nodes = [node["Resources"] for node in living_nodes()]
    if any(room_of(node, settings, learner)[1] for node in nodes):
        return
    raise ValueError(
        f"no node can hold the learner of a cohort, of {learner.cpus:g} CPUs, {learner.gpus:g} GPUs and "
        f"{learner.memory_gib:.1f} GiB, and a run of {settings.player.cpus:g} CPUs and "
        f"{settings.player.memory_gib:g} GiB beside it: the nodes have {offers(nodes)}; give '--cohort "
        f"off' or a smaller number, add larger nodes, or give '--autoscaling' if the cluster adds them"
    )


AUTOSCALING_LEARNERS = 4  # learners that wait for nodes of an autoscaling cluster

LONGEST_LOOK = 5.0
"""Longest time that counts between two looks at a learner, s: the driver may have slept itself."""

logger = logging.getLogger(__name__)


@dataclass
class _Cohort:
    """A learner and the runs that have a place on its node."""

    actor: Any
    node: str
    width: int
    places: int
    opened: Any
    ended: Any
    learner: Learner | None = None
    runs: dict[str, Kind] = field(default_factory=dict)
    asked: Any = None
    progress: LearnerProgress | None = None
    silent_since: float | None = None
    unanswered: float = 0.0
    looked_at: float = field(default_factory=time.monotonic)

    def choose(self, waiting: Sequence[RunSpec], kinds: Mapping[str, Kind]) -> int | None:
        """Return the number of the run that fits best: of a kind that learns here already, or a new one."""
        if len(self.runs) >= self.places:
            return None
        counts, new = Counter(self.runs.values()), None
        for number, spec in enumerate(waiting):
            kind = kinds[spec.run_id]
            if 0 < counts[kind] < self.width:
                return number
            if new is None and not counts[kind]:
                new = number
        return new


class Cohorts:
    """Learners of cohorts and the runs of each: one learner per GPU, or per so many runs on a CPU.

    A learner that is lost is replaced; its runs lose their connection, and continue with another.
    Where memory does not suffice, learners with half as many slots follow.
    """

    def __init__(
        self,
        settings: Settings,
        head: Head,
        specs: Sequence[RunSpec],
        kinds: Mapping[str, Kind],
        learner_type: type[LearnerActor] = LearnerActor,
    ) -> None:
        self._settings, self._head, self._type = settings, head, learner_type
        self._specs, self._kinds = specs, kinds
        self._cohorts: list[_Cohort] = []
        self._blameless: set[str] = set()
        self._resources: Resources = learner_resources(settings, specs, self._kinds)
        self._compiled = compilation(specs) if self._resources.gpus else False

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Remove from `waiting` a run that a listening learner has a slot for; None without one."""
        for cohort in self._cohorts:
            number = None if cohort.learner is None else cohort.choose(waiting, self._kinds)
            if number is not None:
                spec = waiting[number]
                del waiting[number]
                cohort.runs[spec.run_id] = self._kinds[spec.run_id]
                return spec
        self._grow(len(waiting))
        return None

    def learner_of(self, run_id: str) -> tuple[Learner | None, str]:
        """Return the learner of a run that was taken, and Ray's id of the node that both have to be on."""
        return next((each.learner, each.node) for each in self._cohorts if run_id in each.runs)

    def leave(self, run_id: str) -> None:
        """Free the slot of a run that has ended, however it did."""
        self._blameless.discard(run_id)
        for cohort in self._cohorts:
            cohort.runs.pop(run_id, None)

    def lost_without_fault(self, run_id: str) -> bool:
        """Return True if memory did not suffice for the learner of a run that has not left yet."""
        return run_id in self._blameless

    def look(self, *, over: bool) -> Sequence[LearnerProgress]:
        """Update the state of the learners: listening, ended, progress; `over`: no run is to come."""
        for cohort in list(self._cohorts):
            if not self._lives(cohort) or (over and not cohort.runs):
                self._end(cohort)
                continue
            if cohort.learner is None and _come(cohort.opened):
                with suppress(RayError, MemoryError):  # its end says the same, and is dealt with there
                    cohort.learner, node = ray.get(cohort.opened)
                    for each in self._head.nodes() if not cohort.node else ():
                        if each["NodeID"] == node:
                            cohort.places = room_of(each["Resources"], self._settings, self._resources)[1]
                    cohort.node = node
            self._poll(cohort)
        return [cohort.progress for cohort in self._cohorts if cohort.progress is not None]

    def close(self) -> None:
        """End all learners."""
        for cohort in list(self._cohorts):
            self._end(cohort)

    def _grow(self, waiting: int) -> None:
        """Start learners for runs that wait, as far as nodes have room."""
        free = sum(cohort.places - len(cohort.runs) for cohort in self._cohorts if cohort.learner is None)
        while waiting > free:
            found = self._free_node()
            if found is None:
                return
            node, places = found
            settings = self._settings
            of_cohort = CohortSettings(settings.device, settings.width, self._compiled)
            actor = self._type.launch(of_cohort, self._resources, node)
            opened, ended = actor.open.remote(), actor.serve.remote()
            self._cohorts.append(_Cohort(actor, node, settings.width, places, opened, ended))
            free += places

    def _free_node(self) -> tuple[str, int] | None:
        """Return a node with room for a learner, "" for one to come, and how many players it holds then."""
        taken = Counter(cohort.node for cohort in self._cohorts)
        for node in self._head.nodes():
            learners, players = room_of(node["Resources"], self._settings, self._resources)
            if taken[node["NodeID"]] < learners and players:
                return node["NodeID"], players
        if self._settings.autoscaling and taken[""] < AUTOSCALING_LEARNERS:
            return "", self._settings.width
        return None

    def _poll(self, cohort: _Cohort) -> None:
        now = time.monotonic()
        passed, cohort.looked_at = min(now - cohort.looked_at, LONGEST_LOOK), now
        if cohort.asked is not None:
            if not _come(cohort.asked):
                cohort.unanswered += passed if cohort.learner is not None else 0.0
                return
            asked, cohort.asked = cohort.asked, None
            with suppress(RayError):
                cohort.progress = ray.get(asked)
                cohort.silent_since, cohort.unanswered = None, 0.0
        cohort.asked = cohort.actor.report.remote()

    def _lives(self, cohort: _Cohort) -> bool:
        """Return True unless a learner has certainly ended; then log the reason."""
        if not _come(cohort.ended):
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
                    cohort.ended, cohort.asked = cohort.actor.serve.remote(), None
                    return True
            _warn(cohort, error)
        return False

    def _narrow(self, cohort: _Cohort, error: MemoryError) -> None:
        """Halve the width of future learners, so that the runs of this one can continue."""
        if cohort.width == 1:
            _warn(cohort, error)
            return
        self._blameless |= set(cohort.runs)
        width = min(self._settings.width, cohort.width // 2)
        self._settings = replace(self._settings, cohort=width)
        self._resources = learner_resources(self._settings, self._specs, self._kinds)
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
    """Return the mode in which updates are compiled on a GPU; with autotuning if all products are bfloat16.

    There it doubles the speed, for minutes at the start. It chooses kernels by their time, so that another
    machine, or this one without its cache, rounds differently; elsewhere that is not worth its gain.
    """
    medium = all(spec.student_hyperparameters.get("matmul_precision") == "medium" for spec in specs)
    return True if medium else "default"


def _come(reference: Any) -> bool:
    come, _ = ray.wait([reference], timeout=0)
    return bool(come)


def _warn(cohort: _Cohort, error: Exception) -> None:
    logger.warning(
        "the learner of a cohort was lost, and %d runs resume from their checkpoints: %s",
        len(cohort.runs),
        reason_for_loss(error),
    )
