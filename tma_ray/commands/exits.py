"""The ends of commands: an exit code, and one sentence for whatever was refused."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

from tma_ray.commands.interrupts import INTERRUPTED, Interrupts
from tma_ray.commands.texts import VisibleStream

FAILED = 1
"""Something went wrong on the way, or something that was asked about is not as it should be."""

REFUSED = 2
"""Nothing was done; a sentence on standard error says why."""

RAY_LOST = 75
"""Ray is gone, and the same command continues: `os.EX_TEMPFAIL`, which services and batch systems know."""

BROKEN_PIPE = 141
"""Nobody reads the output any more: 128 and the number of the signal, as of a shell."""


class RefusedError(RuntimeError):
    """A request that cannot be met now, through no fault of its own; its message is for the user."""


def exit_code(name: str, command: Callable[[], int], *, debug: bool = False) -> int:
    """Runs a command and returns its exit code; what it refuses becomes a sentence on standard error.

    What it prints holds nothing that a terminal would obey, but for what rich paints. Errors that no user
    can cause are raised as they come.

    Args:
        name: of the command, before the sentence.
        command: returns its exit code.
        debug: prints the traceback of a refusal, too.
    """
    interrupts = Interrupts()
    with redirect_stdout(VisibleStream(sys.stdout)), redirect_stderr(VisibleStream(sys.stderr)):
        return _ended(name, command, interrupts, debug)


def _ended(name: str, command: Callable[[], int], interrupts: Interrupts, debug: bool) -> int:
    try:
        with interrupts.raised():
            code = command()
            sys.stdout.flush()
        return INTERRUPTED if interrupts.came else code
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        _discard_output()
        return BROKEN_PIPE
    except (ValueError, OSError, MemoryError, RefusedError) as error:
        if interrupts.came:
            return INTERRUPTED
        if debug:
            traceback.print_exception(error)
        sys.stderr.write(f"{name}: {sentence(error)}\n")
        return REFUSED
    except Exception:
        if interrupts.came:  # what a library made of it
            return INTERRUPTED
        raise


def sentence(error: BaseException) -> str:
    """Returns what `error` says, for a user."""
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this: {str(error) or 'ask for less'}"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror.lower()}"
    return str(error) or type(error).__name__


def _discard_output() -> None:
    """Lets Python end without writing what nobody reads."""
    with suppress(OSError, ValueError), Path(os.devnull).open("w") as nowhere:  # it may have no descriptor
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
