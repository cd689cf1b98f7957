"""Ctrl-C while the package is being imported; it imports next to nothing itself, to be there at once."""

import contextlib
import os
import signal

INTERRUPTED = 130
"""Exit code of a command that was stopped by Ctrl-C: 128 and the number of the signal, as of a shell."""


def is_command(arguments: list[str]) -> bool:
    """Tells whether the interpreter with these arguments was started for the command ``tma-ray``."""
    stems = {os.path.basename(word).partition(".")[0] for word in arguments[:2]}  # noqa: PTH119
    return bool({"tma_ray", "tma_ray.cli"} & set(arguments[1:3])) or "tma-ray" in stems


def leave_at_once(*_: object) -> None:
    """Ends the process: for a time when nothing has been started yet, or all is done."""
    os._exit(INTERRUPTED)


def expect_early() -> None:
    """Answers Ctrl-C while the command imports the package."""
    with contextlib.suppress(ValueError):  # another thread than the main one imports it
        signal.signal(signal.SIGINT, leave_at_once)
