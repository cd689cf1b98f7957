"""A run in this process: the same attempt that actors make, with its own committer."""

from __future__ import annotations

import platform
import time
import traceback
from collections.abc import Callable
from datetime import UTC, datetime

from tma_ray.results import AttemptOutcome, AttemptRecord, Committer, RunStatus
from tma_ray.runs.attempt import Attempt
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.placement import Placement, Status
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher


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
        Exception: whatever the run's parts raise, after the run is marked as failed.
    """
    record, published = spec.record(), committer.manifest(spec.run_id)
    if published is not None and published.status is RunStatus.DONE:
        return AttemptOutcome.DONE
    number = committer.start(record)
    started_at, started = datetime.now(UTC), time.monotonic()
    outcome, attempt = AttemptOutcome.FAILED, None
    try:
        attempt = Attempt(spec, committer.store, number, InlineTeacher(spec), placement)

        def stop_asked() -> bool:
            assert attempt is not None
            on_status(attempt.status())
            return should_stop()

        final = attempt.execute(stop_asked, lambda parts: committer.publish(record, number, parts))
        outcome = AttemptOutcome.STOPPED if final is None else AttemptOutcome.DONE
        if final is not None:
            committer.finish(record, number, final)
            Checkpoints(committer.store, spec.run_id, number).drop()
    except Exception:
        committer.fail(record, number, traceback.format_exc())
        raise
    finally:
        if attempt is not None:
            seconds = time.monotonic() - started
            committer.record_attempt(
                AttemptRecord(
                    run_id=spec.run_id,
                    attempt=number,
                    started_at=started_at,
                    wall_seconds=seconds,
                    env_steps_per_second=attempt.status().steps_per_second,
                    host=platform.node(),
                    fingerprint=attempt.fingerprint,
                    outcome=outcome,
                )
            )
            attempt.close()
    return outcome
