"""Errors of a storage that refuses an operation, and retries until it accepts it."""

from __future__ import annotations

import errno
import logging
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

from tma_ray.decoding import DamagedFileError

T = TypeVar("T")

FIRST_PAUSE: Final = 1.0
"""Before an operation is tried again that the storage refused, s; doubled with every other refusal."""

LONGEST_PAUSE: Final = 60.0
"""Bound of that pause, s."""

DISK_FULL: Final = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers of a disk, or one's share of it, that is full."""

_ADVICE: Final = {
    errno.ENOSPC: "free some space there",
    errno.EDQUOT: "your quota there is used up; free some space",
    errno.EROFS: "it is mounted read-only",
    errno.EACCES: "you may not do that there",
    errno.ENOTDIR: "part of it is a file, not a folder",
    errno.ELOOP: "its symbolic links lead in a circle",
    errno.ENAMETOOLONG: "a name in it is too long",
}

logger = logging.getLogger(__name__)


class ResultsRootError(ValueError):
    """A place that cannot be used as a results root; the message says why and what to do."""


class StorageError(OSError):
    """The storage of a results root refuses an operation; the message names the file and a remedy."""


@contextmanager
def explained_disk(where: str, kinds: Collection[int] | None = None) -> Iterator[None]:
    """Turns what the operating system raises within the block into errors that name `where`.

    Args:
        where: the file or folder.
        kinds: error numbers that are explained; None for all.

    Raises:
        FileNotFoundError: as it came.
        DamagedFileError: a folder lies where the file should be.
        StorageError: everything else.
        OSError: as it came, of another kind.
    """
    try:
        yield
    except (FileNotFoundError, StorageError):
        raise
    except IsADirectoryError as error:  # which no patience mends
        raise DamagedFileError(f"{where} is damaged: a folder lies in its place") from error
    except OSError as error:
        if kinds is not None and error.errno not in kinds:
            raise
        advice = _ADVICE.get(error.errno or 0, "the disk refuses it")
        raise StorageError(
            f"{where}: {advice} ({error}); what was published before is safe, and the same command continues "
            f"from there"
        ) from error


def retry(action: Callable[[], T], seconds: float, give_up: Callable[[], bool] = lambda: False) -> T:
    """Repeats `action` as long as the storage refuses it; returns what it returns at last.

    Args:
        action: may be called again after it was interrupted by a `StorageError`.
        seconds: how long to repeat it.
        give_up: asked before every pause.

    Raises:
        StorageError: it still refuses after `seconds`, or `give_up` returned true.
    """
    start, pause = time.monotonic(), FIRST_PAUSE
    while True:
        try:
            return action()
        except StorageError as error:
            passed = time.monotonic() - start
            if passed >= seconds or give_up():
                raise
            logger.warning("%s; trying again for another %.0f s", error, seconds - passed)
            time.sleep(min(pause, seconds - passed))
            pause = min(2 * pause, LONGEST_PAUSE)
