"""Exit codes of commands, and messages for refused requests."""

import os
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tma_ray.console.terminal import standard_streams
from tma_ray.support.interrupts import INTERRUPTED, raised_interrupts

FAILED = 1  # exit code of an error, or of a failed check
REFUSED = 2  # exit code of a refusal, with its reason on standard error
RAY_LOST = 75  # exit code after the loss of Ray (`os.EX_TEMPFAIL`); the same command resumes
BROKEN_PIPE = 141  # exit code after a broken pipe: 128 + SIGPIPE, as in shells


class RefusedError(RuntimeError):
    """Error for a valid request that cannot be met now; its message is for the user."""


def exit_code(name: str, command: Callable[[], int], *, debug: bool = False) -> int:
    """Run a command, print a refusal as a sentence to standard error, and return the exit code.

    Control characters in its output are replaced, except rich's. Internal errors are raised; `debug` prints
    the traceback of a refusal, too.
    """
    interrupts: list[int] = []
    with standard_streams():
        try:
            with raised_interrupts(interrupts):
                code = command()
                sys.stdout.flush()
            return INTERRUPTED if interrupts else code
        except KeyboardInterrupt:
            return INTERRUPTED
        except BrokenPipeError:
            # prevent Python from flushing into the closed pipe at exit
            with suppress(OSError, ValueError), Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), sys.stdout.fileno())
            return BROKEN_PIPE
        except (ValueError, OSError, MemoryError, RefusedError) as error:
            if interrupts:
                return INTERRUPTED
            if debug:
                traceback.print_exception(error)
            sys.stderr.write(f"{name}: {sentence(error)}\n")
            return REFUSED
        except Exception:
            if interrupts:  # a library may have converted KeyboardInterrupt
                return INTERRUPTED
            raise


def sentence(error: BaseException) -> str:
    """Return the message of an error as a sentence for users."""
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this: {str(error) or 'ask for less'}"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror.lower()}"
    return str(error) or type(error).__name__


def installed_version(package: str) -> str:
    """Return the version of an installed package.

    Raises:
        RefusedError: if it is not installed, as when its folder was only copied.
    """
    try:
        return version(package)
    except PackageNotFoundError as error:
        raise RefusedError(
            f"the package {package!r} is not installed for {sys.executable}: a copied folder is not enough; "
            f"use 'pip install {package}', or 'pip install .' in a checkout"
        ) from error
