"""A watch over Ray's head while it starts and a campaign is checked: no run is there yet to be waited for."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from tma_ray.campaign.cluster.head import Watched
from tma_ray.commands.exits import RAY_LOST

PATIENCE_SECONDS: Final = 20.0
"""Silence of a head after which a campaign that has not begun is given up, s."""

LOOK_SECONDS: Final = 1.0
"""Time between two looks, s."""


@contextmanager
def leaving_without_head(head: Watched, name: str) -> Iterator[None]:
    """Ends this process with a message and `RAY_LOST` if Ray's head is lost while the block runs.

    A call of Ray waits for a head that is gone until Ray itself ends the process, after 60 s and without a
    word, and cannot be interrupted. What a campaign has at this time needs no end of its own.

    Args:
        head: that is watched.
        name: of the campaign, for the message.
    """
    done = threading.Event()

    def watch() -> None:
        while not done.wait(LOOK_SECONDS):
            reason = head.lost(PATIENCE_SECONDS)
            if reason is not None and not done.is_set():
                head.abandon()
                sys.stderr.write(f"{name}: {reason}; no run had been started; give the same command again\n")
                sys.stderr.flush()
                os._exit(RAY_LOST)

    threading.Thread(target=watch, name="ray-head-of-preflight", daemon=True).start()
    try:
        yield
    finally:
        done.set()
