"""A run in this process: the same attempt that actors make, with its own committer."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence

from tma_ray.commands.arguments import check_kind
from tma_ray.results import AttemptOutcome, Committer, PartFile, StorageError, retry
from tma_ray.runs.attempt import Attempt
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.inputs import fetch, keep
from tma_ray.runs.placement import Placement, Status
from tma_ray.runs.run_log import RunLog
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher
from tma_ray.students.players import LearnerLostError


def run_locally(
    spec: RunSpec,
    committer: Committer,
    placement: Placement | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_status: Callable[[Status], None] = lambda _: None,
) -> AttemptOutcome:
    """Runs `spec` in this process, from its newest checkpoint if there is one.

    Args:
        spec: what to run; nothing happens if the root holds its results already.
        committer: of the results root.
        placement: device, threads, time between checkpoints.
        should_stop: asked after every episode; a stopped run leaves a checkpoint.
        on_status: told the run's status after every episode.

    Returns:
        How the attempt ended.

    Raises:
        StorageError: the root refused to take what was written for long; the run can be taken up again.
        LearnerLostError: the learner of its cohort is gone; likewise.
        Exception: whatever the run's parts raise, after the run is marked as failed.
    """
    check_kind("spec", spec, RunSpec, "a RunSpec, as of effective_spec")
    check_kind("committer", committer, Committer, "a Committer, as Committer.open('results')")
    if committer.done([spec.run_id]):
        return AttemptOutcome.DONE
    return _attempt(spec, committer, placement or Placement(), should_stop, on_status)


def _attempt(
    spec: RunSpec,
    committer: Committer,
    placement: Placement,
    should_stop: Callable[[], bool],
    on_status: Callable[[Status], None],
) -> AttemptOutcome:
    record = spec.record()
    keep(committer.store, [spec])
    fetch(committer.store, spec)
    number = committer.start(record)
    attempt, outcome = None, AttemptOutcome.FAILED
    try:
        with RunLog(committer.store, spec.run_id, number) as log:

            def publish(parts: Sequence[PartFile]) -> None:
                retry(lambda: committer.publish(record, number, parts), placement.outage_seconds, should_stop)
                log.publish()

            attempt = Attempt(spec, committer.store, number, InlineTeacher(spec), placement)
            final = attempt.execute(_reporting(attempt, should_stop, on_status), publish)
        outcome = AttemptOutcome.STOPPED if final is None else AttemptOutcome.DONE
        if final is not None:
            retry(lambda: committer.finish(record, number, final), placement.outage_seconds, should_stop)
            Checkpoints(committer.store, spec.run_id, number).drop()
    except (StorageError, LearnerLostError):
        outcome = AttemptOutcome.LOST
        raise
    except Exception:
        committer.fail(record, number, traceback.format_exc())
        raise
    finally:
        if attempt is not None:
            committer.record_attempt(attempt.record(outcome))
            attempt.close()
    return outcome


def _reporting(
    attempt: Attempt, should_stop: Callable[[], bool], on_status: Callable[[Status], None]
) -> Callable[[], bool]:
    def asked() -> bool:
        on_status(attempt.status())
        return should_stop()

    return asked
