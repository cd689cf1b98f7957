"""The log of an attempt, as a file of the results root."""

from __future__ import annotations

import logging
import time
import traceback
from contextlib import suppress
from types import TracebackType
from typing import Self

from tma_ray.results import StorageError, Store, log_path

LOGGER = "tma_ray"
"""Whose messages, and those below it, are kept: plug-ins may log to ``tma_ray.plugins.…``."""


class RunLog(logging.Handler):
    """Context that keeps this process's messages from INFO on, and publishes them when asked and at its end.

    The file is written whole each time, since object stores cannot append. An exception that leaves the
    context is its last message. Of a process that is killed, what came after the last publication is lost.

    Args:
        store: the results root.
        run_id: of the run.
        attempt: its number.
    """

    def __init__(self, store: Store, run_id: str, attempt: int) -> None:
        super().__init__(logging.INFO)
        formatter = logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%Y-%m-%d %H:%M:%S")
        formatter.converter = time.gmtime
        self.setFormatter(formatter)
        self._store, self._path = store, log_path(run_id, attempt)
        self._lines: list[str] = []
        self._published = 0

    def __enter__(self) -> Self:
        logger = logging.getLogger(LOGGER)
        self._level_before = logger.level
        logger.setLevel(min(logger.getEffectiveLevel(), logging.INFO))
        logger.addHandler(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        logger = logging.getLogger(LOGGER)
        if error is not None:
            self._lines += "".join(traceback.format_exception(error)).rstrip().splitlines()
        logger.removeHandler(self)
        logger.setLevel(self._level_before)
        self.publish()

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps a message."""
        self._lines.append(self.format(record))

    def publish(self) -> None:
        """Writes all messages so far, if there are new ones."""
        count = len(self._lines)
        if count > self._published:
            with suppress(StorageError):  # no run fails for its log; the next publication holds all
                self._store.write_bytes(self._path, ("\n".join(self._lines) + "\n").encode())
                self._published = count
