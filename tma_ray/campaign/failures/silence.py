"""Runs that do not answer and are not known to be dead: for how long, and a message now and then."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

LOG_SECONDS = 60.0
"""Time between two messages, s."""

MOST_NAMES = 3
"""Runs that a message names; the others are counted."""

logger = logging.getLogger(__name__)


class Silence:
    """Runs that do not answer: Ray may lose sight of an actor, or of a node with many, and find it again.

    Args:
        most_seconds: how long a run may be silent before it counts as lost, s.
        clock: current time, s.
    """

    def __init__(self, most_seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._most_seconds = most_seconds
        self._clock = clock
        self._since: dict[str, float] = {}
        self._logged = -math.inf

    def lasts(self, run_id: str) -> bool:
        """Takes in that a run did not answer; returns True if it has been silent for too long.

        All runs that are silent at the moment are logged, once a minute.
        """
        now = self._clock()
        since = self._since.setdefault(run_id, now)
        if now - self._logged >= LOG_SECONDS:
            self._logged = now
            names = sorted(self._since)
            more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
            verb = "do not answer and are" if len(names) > 1 else "does not answer and is"
            logger.warning(
                "%s%s %s not known to be dead; after %.0f s of silence a run counts as lost",
                ", ".join(names[:MOST_NAMES]),
                more,
                verb,
                self._most_seconds,
            )
        return now - since > self._most_seconds

    def end(self, run_id: str) -> None:
        """Takes in that a run answers, or is lost."""
        self._since.pop(run_id, None)
