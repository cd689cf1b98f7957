"""Ctrl-C while a command is starting, running or ending: exit code 130, and no traceback."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Final

INTERRUPTED: Final = 130
"""Exit code of a command that was stopped by Ctrl-C: 128 and the number of the signal, as of a shell."""


def is_command(arguments: list[str]) -> bool:
    """Tells whether the interpreter with these arguments was started for the command ``tma-ray``."""
    return "tma_ray.cli" in arguments[1:3] or any(Path(word).stem == "tma-ray" for word in arguments[:2])


def leave_at_once(*_: object) -> None:
    """Ends the process: for a time when nothing has been started yet, or all is done."""
    os._exit(INTERRUPTED)


def expect_early() -> None:
    """Answers Ctrl-C while the package is being imported, if that is done for the command."""
    if is_command(sys.orig_argv) and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, leave_at_once)


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
