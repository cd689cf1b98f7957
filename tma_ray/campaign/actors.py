"""Ray actors that execute runs: one seed actor per run, which owns its teacher actor."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import ray

from tma_ray.campaign.placing.launching import launcher, node_strategy
from tma_ray.campaign.preflight.shipping import use_shipped
from tma_ray.campaign.settings import Resources, TeacherPlacement
from tma_ray.results import AttemptOutcome, AttemptRecord, PartFile, Store, leave_pandas_out
from tma_ray.runs.inputs import contents, fetch, provide
from tma_ray.runs.placement import Placement, Status
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher, TeacherLink

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

CONCURRENT_CALLS = 4
"""Of a seed actor at once: the run, another that waits for it, a report and a request."""


@dataclass(frozen=True)
class Report:
    """Message of a seed actor to the scheduler.

    Attributes:
        record: of the attempt, as if its process were lost now.
        status: where the run stands.
        parts: result files that its newest checkpoint holds; None before the first.
        node: Ray's id of where it runs.
    """

    record: AttemptRecord
    status: Status
    parts: tuple[PartFile, ...] | None
    node: str


class TeacherActor(InlineTeacher):
    """A teacher in a process of its own; it imports torch only if its algorithm does."""

    def __init__(self, spec: dict[str, Any], inputs: Mapping[str, bytes]) -> None:
        use_shipped()
        provide(inputs)
        super().__init__(RunSpec.from_dict(spec))


def _remote(
    method: Callable[Concatenate[InlineTeacher, Arguments], Result],
) -> Callable[Concatenate[RemoteTeacher, Arguments], Result]:
    """Returns a method of `RemoteTeacher` that calls `method` of its actor: one message each way."""

    def call(self: RemoteTeacher, /, *arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        return cast("Result", ray.get(getattr(self.actor, method.__name__).remote(*arguments, **options)))

    call.__doc__ = method.__doc__
    return call


class RemoteTeacher:
    """The link to a teacher actor on this node; see `TeacherLink`. The actor dies with this process."""

    def __init__(self, spec: RunSpec) -> None:
        here = node_strategy(ray.get_runtime_context().get_node_id())
        remote: Any = ray.remote(TeacherActor)
        options = {"num_cpus": 0, "max_restarts": 0, "scheduling_strategy": here}
        self.actor = remote.options(**options).remote(spec.to_dict(), contents([spec]))

    exchange = _remote(InlineTeacher.exchange)
    answer = _remote(InlineTeacher.answer)
    probe = _remote(InlineTeacher.probe)
    save = _remote(InlineTeacher.save)
    load = _remote(InlineTeacher.load)


class SeedActor:
    """One attempt at one run: `run` trains, while `report` and `request_stop` are answered beside it.

    `launch` makes one on the cluster. Restarts are the scheduler's business: an actor that Ray
    restarts would not know that its attempt no longer counts.
    """

    def __init__(
        self,
        spec: dict[str, Any],
        store: Store,
        number: int,
        placement: Placement,
        teachers: TeacherPlacement,
    ) -> None:
        self._spec = RunSpec.from_dict(spec)
        self._store = store
        self._number = number
        self._placement = placement
        self._teachers = teachers
        self._stop = threading.Event()
        self._attempt: Any = None
        self._parts: tuple[PartFile, ...] | None = None
        self._outcome: Future[tuple[PartFile, ...] | None] | None = None
        self._first_call = threading.Lock()

    @classmethod
    def launch(cls, resources: Resources, strategy: Any, *arguments: Any) -> Any:
        """Returns the handle of a new seed actor on a node of `node_strategy`, made with `arguments`."""
        return launcher(cls, resources, strategy, CONCURRENT_CALLS).remote(*arguments)

    def run(self) -> tuple[PartFile, ...] | None:
        """Executes the attempt; returns the canonical result files, or None after a stop.

        Another call waits for the first one and returns the same: the scheduler calls again if it lost
        sight of this actor.

        Raises:
            Exception: whatever teacher, student or environment raise.
        """
        with self._first_call:
            outcome, self._outcome = self._outcome, self._outcome or Future()
        if outcome is not None:
            return outcome.result()
        assert self._outcome is not None
        try:
            self._outcome.set_result(self._train())
        except Exception as error:
            self._outcome.set_exception(error)
        return self._outcome.result()

    def _train(self) -> tuple[PartFile, ...] | None:
        leave_pandas_out()
        self._placement.give_way()
        use_shipped()
        # Imported here, so that a failing import is the run's error and not the actor's death.
        from tma_ray.runs.attempt import Attempt
        from tma_ray.runs.run_log import RunLog

        inline = self._teachers is TeacherPlacement.INLINE
        with RunLog(self._store, self._spec.run_id, self._number) as log:
            fetch(self._store, self._spec)
            teacher: TeacherLink = InlineTeacher(self._spec) if inline else RemoteTeacher(self._spec)
            self._attempt = Attempt(self._spec, self._store, self._number, teacher, self._placement)

            def note(parts: Sequence[PartFile]) -> None:
                self._parts = tuple(parts)
                log.publish()

            return cast("tuple[PartFile, ...] | None", self._attempt.execute(self._stop.is_set, note))

    def report(self) -> Report | None:
        """Returns where the run stands; None while it is being set up."""
        if self._attempt is None:
            return None
        return Report(
            record=self._attempt.record(AttemptOutcome.LOST),
            status=self._attempt.status(),
            parts=self._parts,
            node=ray.get_runtime_context().get_node_id(),
        )

    def request_stop(self) -> None:
        """Asks the run for a checkpoint at the next episode end, and to return."""
        self._stop.set()
