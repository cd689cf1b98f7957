"""Work on files beside the learner's own, which does not wait for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any

AT_ONCE = 2
"""Threads: checkpoints of so many runs are written or read at a time."""

Conclusion = Callable[[Any], Any]
"""Makes the reply of what was returned, in the learner's own thread."""


class Aside:
    """Executes work in threads, and keeps what it returns for the thread that asked.

    Args:
        wake: called in a thread whenever work is done.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._threads = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="files")
        self._done: deque[tuple[Connection, Any, Conclusion]] = deque()

    def start(self, connection: Connection, work: Callable[[], Any], then: Conclusion) -> None:
        """Starts work for a connection; `done` has what it returns, or the error that it raises."""

        def execute() -> None:
            try:
                result = work()
            except Exception as error:
                result = error
            self._done.append((connection, result, then))
            self._wake()

        self._threads.submit(execute)

    def done(self) -> Iterator[tuple[Connection, Any, Conclusion]]:
        """Yields what is done since the last call."""
        while self._done:
            yield self._done.popleft()
