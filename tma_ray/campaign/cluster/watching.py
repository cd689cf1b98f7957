"""A watch over Ray's head beside the thread that calls Ray, whose calls wait for a head that is gone."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from tma_ray.campaign.cluster.head import Watched
from tma_ray.commands.exits import RAY_LOST

PATIENCE_SECONDS: Final = 20.0
"""Silence of a head after which a campaign that has not begun is given up, s."""

LOOK_SECONDS: Final = 1.0
"""Time between two looks, s."""

GRACE_SECONDS: Final = 6.0
"""Time in which a loop that looks after the head itself ends by itself, s."""

NOT_BEGUN: Final = "no run had been started; give the same command again"

BEGUN: Final = "the same command continues where it was"


@contextmanager
def leaving_without_head(
    head: Watched,
    name: str,
    advice: str = NOT_BEGUN,
    *,
    grace: float = 0.0,
    conclude: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Ends this process with a message and `RAY_LOST` if Ray's head is lost while the block runs.

    A call of Ray waits for a head that is gone until Ray itself ends the process, after 60 s and without a
    word, and cannot be interrupted.

    Args:
        head: that is watched.
        name: of the campaign, for the message.
        advice: for the message.
        grace: time that the block has to find out and to end by itself, s.
        conclude: writes what there is to be said of the end; nothing of Ray may be called.
    """
    done = threading.Event()

    def watch() -> None:
        while not done.wait(LOOK_SECONDS):
            if head.lost(PATIENCE_SECONDS) is None or done.wait(grace):
                continue
            reason = head.lost(PATIENCE_SECONDS)
            if reason is not None and not done.is_set():
                _leave(head, f"{name}: {reason}; {advice}\n", conclude)

    threading.Thread(target=watch, name="watch-over-ray-head", daemon=True).start()
    try:
        yield
    finally:
        done.set()


def _leave(head: Watched, message: str, conclude: Callable[[], None]) -> None:
    try:
        head.abandon()
        conclude()
    finally:
        sys.stderr.write(message)
        sys.stderr.flush()
        os._exit(RAY_LOST)
