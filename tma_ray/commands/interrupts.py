"""Ctrl-C while a command is starting, running or ending: exit code 130, and no traceback."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from tma_ray.commands.early_interrupts import INTERRUPTED, expect_early, is_command, leave_at_once

__all__ = [
    "INTERRUPTED",
    "Interrupts",
    "come_into_reach",
    "expect_early",
    "is_command",
    "leave_at_once",
    "started_out_of_reach",
]


@contextmanager
def started_out_of_reach() -> Iterator[None]:
    """Has processes that are started in the block see no Ctrl-C, which a terminal sends to all.

    One that comes meanwhile reaches this process at the end of the block, and those when they
    `come_into_reach`: until then they import, where it would end in a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def come_into_reach() -> None:
    """Lets Ctrl-C, also an earlier one, end this process without a word."""
    signal.signal(signal.SIGINT, leave_at_once)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


class Interrupts:
    """Ctrl-C as KeyboardInterrupt, remembered.

    Libraries turn a KeyboardInterrupt into errors of their own, or lose it where Python cannot raise it.

    Attributes:
        came: whether there was one.
    """

    def __init__(self) -> None:
        self.came = False

    @contextmanager
    def raised(self) -> Iterator[None]:
        """Raises KeyboardInterrupt upon Ctrl-C within the block, if that is in the main thread."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        handler, hook = signal.signal(signal.SIGINT, self._raise), sys.unraisablehook
        sys.unraisablehook = self._leave_if_lost
        try:
            yield
        finally:
            sys.unraisablehook = hook
            signal.signal(signal.SIGINT, handler)

    def _raise(self, _number: int, _frame: FrameType | None) -> None:
        self.came = True
        raise KeyboardInterrupt

    def _leave_if_lost(self, lost: Any) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            leave_at_once()
        sys.__unraisablehook__(lost)
