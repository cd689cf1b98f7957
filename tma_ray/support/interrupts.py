"""Handling of Ctrl-C at any time during a command: exit code 130 without a traceback.

This module is imported first, and so imports only modules that are loaded already.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

INTERRUPTED = 130  # exit code after Ctrl-C: 128 + SIGINT, as in shells


def is_command(arguments: list[str]) -> bool:
    """Return True if an interpreter with these arguments is running the command ``tma-ray``."""
    stems = {os.path.basename(word).partition(".")[0] for word in arguments[:2]}  # noqa: PTH119
    return "tma_ray" in arguments[1:3] or "tma-ray" in stems


def leave_at_once(*_: object) -> None:
    """End the process immediately."""
    os._exit(INTERRUPTED)


def expect_early() -> None:
    """Install a handler that ends the process on Ctrl-C during imports."""
    with contextlib.suppress(ValueError):  # raised outside the main thread
        signal.signal(signal.SIGINT, leave_at_once)


@contextlib.contextmanager
def block_sigint() -> Iterator[None]:
    """Context manager in which child processes start with Ctrl-C blocked, to protect their imports.

    A pending Ctrl-C reaches this process at the end of the block, and a child process when it calls
    `unblock_sigint`.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def unblock_sigint() -> None:
    """Unblock Ctrl-C; a pending or later Ctrl-C ends the process without a message."""
    signal.signal(signal.SIGINT, leave_at_once)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextlib.contextmanager
def raised_interrupts(came: list[int]) -> Iterator[None]:
    """Context manager in which Ctrl-C raises KeyboardInterrupt in the main thread and is recorded in `came`.

    The list is needed since libraries may convert or swallow the exception.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    def leave_if_lost(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            leave_at_once()
        sys.__unraisablehook__(lost)

    handler, hook = signal.signal(signal.SIGINT, interrupt), sys.unraisablehook
    sys.unraisablehook = leave_if_lost
    try:
        yield
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGINT, handler)
