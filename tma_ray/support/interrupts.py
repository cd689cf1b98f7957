"""Ctrl-C while a command is starting, running or ending: exit code 130, and no traceback.

It is imported before everything else, and imports only what is there already.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

INTERRUPTED = 130
"""Exit code of a command that was stopped by Ctrl-C: 128 and the number of the signal, as of a shell."""


def is_command(arguments: list[str]) -> bool:
    """True if an interpreter with these arguments runs the command ``tma-ray``."""
    stems = {os.path.basename(word).partition(".")[0] for word in arguments[:2]}  # noqa: PTH119
    return bool({"tma_ray", "tma_ray.cli"} & set(arguments[1:3])) or "tma-ray" in stems


def leave_at_once(*_: object) -> None:
    """End the process, before anything was started or after everything was done."""
    os._exit(INTERRUPTED)


def expect_early() -> None:
    """End the process on Ctrl-C while the command imports the package."""
    with contextlib.suppress(ValueError):  # another thread than the main one imports it
        signal.signal(signal.SIGINT, leave_at_once)


@contextlib.contextmanager
def block_sigint() -> Iterator[None]:
    """Block Ctrl-C, which a terminal sends to all processes, in processes that are started within.

    One that comes meanwhile reaches this process at the end of the block, and the others at `unblock_sigint`:
    until then they import, where it would end in a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def unblock_sigint() -> None:
    """Unblock Ctrl-C, which ends this process without a message, also if it came while blocked."""
    signal.signal(signal.SIGINT, leave_at_once)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextlib.contextmanager
def raised_interrupts(came: list[int]) -> Iterator[None]:
    """Context manager in which Ctrl-C raises KeyboardInterrupt, in the main thread, and is added to a list.

    Libraries turn a KeyboardInterrupt into errors of their own, or lose it where Python cannot raise it.
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
