"""Exit codes of commands, and one sentence for every refusal."""

import os
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tma_ray.console.streams import standard_streams
from tma_ray.support.interrupts import INTERRUPTED, raised_interrupts

FAILED = 1  # exit code of an error, or of a check that failed
REFUSED = 2  # exit code of a refusal: nothing was done, and a sentence on standard error says why
RAY_LOST = 75  # exit code after Ray was lost, `os.EX_TEMPFAIL`; the same command continues

BROKEN_PIPE = 141
"""Exit code when nobody reads the output any more: 128 and the number of the signal, as of a shell."""


class RefusedError(RuntimeError):
    """Request that is valid and cannot be met now; the message is for the user."""


def exit_code(name: str, command: Callable[[], int], *, debug: bool = False) -> int:
    """Run a command; return its exit code, and print refusals as a sentence on standard error.

    Control characters in what it prints are replaced, except those of rich. Errors that no user can cause are
    raised; `debug` prints the traceback of a refusal, too.
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
            # Python ends without a write to the closed pipe; a stream may have no descriptor.
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
            if interrupts:  # an error that a library raised instead
                return INTERRUPTED
            raise


def sentence(error: BaseException) -> str:
    """Return the message of an error, for a user."""
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this: {str(error) or 'ask for less'}"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror.lower()}"
    return str(error) or type(error).__name__


def installed_version(package: str) -> str:
    """Return the version of an installed package.

    Raises:
        RefusedError: a package that is not installed, as when its folder was only copied.
    """
    try:
        return version(package)
    except PackageNotFoundError as error:
        raise RefusedError(
            f"the package {package!r} is not installed for {sys.executable}: a copied folder is not enough; "
            f"use 'pip install {package}', or 'pip install .' in a checkout"
        ) from error
