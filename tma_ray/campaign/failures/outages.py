"""Retrying committers: storage that fails for a while does not end a campaign."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from tma_ray.results import Committer, StorageError, Store, retry

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class OutageError(RuntimeError):
    """The storage of a campaign's results failed for longer than its settings allow."""


class RetryingCommitter:
    """Calls the methods of a `Committer`, and retries those that the storage refuses.

    Before every attempt it checks that the lease on the root is still held: a storage that was unavailable
    for long may have been given to another campaign meanwhile.

    Args:
        committer: of the results root.
        keep_lease: renews the lease; raises if another campaign holds it.
        seconds: longest time for which one operation is retried, s.
    """

    def __init__(self, committer: Committer, keep_lease: Callable[[], None], seconds: float) -> None:
        self._committer = committer
        self._keep_lease = keep_lease
        self._seconds = seconds

    @property
    def store(self) -> Store:
        """The storage of the results root."""
        return self._committer.store

    def keep_lease(self) -> None:
        """Renews the lease, with the retries and errors of `call`."""
        self._retry(self._keep_lease)

    def call(
        self,
        operation: Callable[Concatenate[Committer, Arguments], Result],
        *arguments: Arguments.args,
        **options: Arguments.kwargs,
    ) -> Result:
        """Returns what an operation of the committer returns, as in ``call(Committer.manifest, run_id)``.

        Raises:
            RootInUseError: another campaign holds the lease on the root.
            OutageError: the storage refused every attempt.
        """

        def attempt() -> Result:
            self._keep_lease()
            return operation(self._committer, *arguments, **options)

        return self._retry(attempt)

    def _retry(self, action: Callable[[], Result]) -> Result:
        try:
            return retry(action, self._seconds)
        except StorageError as error:
            raise OutageError(f"the campaign ends after {self._seconds:.0f} s of retries: {error}") from error
