"""A committer that waits until its storage answers again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from tma_ray.results import AttemptRecord, Committer, Manifest, PartFile, RunRecord, StorageError, outlast

T = TypeVar("T")


class OutageError(RuntimeError):
    """The storage of a campaign's results was gone for too long."""


class PatientCommitter:
    """Publishes as `Committer` does, and repeats what the storage refuses.

    Before every try it makes sure that the root is still ours: a storage that was gone for long may have
    been given to another campaign meanwhile.

    Args:
        committer: of the results root.
        keep_lease: raises if the root is no longer ours.
        seconds: how long one operation is repeated, s.
    """

    def __init__(self, committer: Committer, keep_lease: Callable[[], None], seconds: float) -> None:
        self.store = committer.store
        self._committer = committer
        self._keep_lease = keep_lease
        self._seconds = seconds

    def keep_lease(self) -> None:
        """Gives a sign of life to other campaigns.

        Raises:
            RootInUseError: the root is no longer ours; as do all other methods.
            OutageError: after all tries; likewise.
        """
        self._outlast(lambda: None)

    def manifest(self, run_id: str) -> Manifest | None:
        """See `Committer`."""
        return self._outlast(lambda: self._committer.manifest(run_id))

    def start(self, run: RunRecord) -> int:
        """See `Committer`."""
        return self._outlast(lambda: self._committer.start(run))

    def publish(self, run: RunRecord, attempt: int, parts: Sequence[PartFile]) -> None:
        """See `Committer`."""
        self._outlast(lambda: self._committer.publish(run, attempt, parts))

    def finish(self, run: RunRecord, attempt: int, final: Sequence[PartFile]) -> None:
        """See `Committer`."""
        self._outlast(lambda: self._committer.finish(run, attempt, final))

    def fail(self, run: RunRecord, attempt: int, error: str) -> None:
        """See `Committer`."""
        self._outlast(lambda: self._committer.fail(run, attempt, error))

    def record_attempt(self, record: AttemptRecord) -> None:
        """See `Committer`."""
        self._outlast(lambda: self._committer.record_attempt(record))

    def _outlast(self, action: Callable[[], T]) -> T:
        def with_lease() -> T:
            self._keep_lease()
            return action()

        try:
            return outlast(with_lease, self._seconds)
        except StorageError as error:
            raise OutageError(f"the campaign ends after {self._seconds:.0f} s of trying: {error}") from error
