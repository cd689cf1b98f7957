"""Protocols of a monitored Ray head, and a context manager that ends the process if the head is lost."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, Protocol

from tma_ray.console.exit_codes import RAY_LOST


class Watched(Protocol):
    """Ray cluster whose head is monitored while a campaign runs."""

    def failure_reason(self, patience: float) -> str | None:
        """Return the reason why the head counts as lost, or None; silence counts after `patience` seconds."""

    def kill(self) -> None:
        """Kill Ray's remaining processes if this process started Ray, without calling Ray."""


class Head(Watched, Protocol):
    """Head node of a Ray cluster; it runs the Global Control Store (GCS) that all other processes need."""

    def nodes(self) -> list[dict[str, Any]]:
        """Return Ray's records of live nodes, with "NodeID" and "Resources", without waiting for Ray."""

    def check(self) -> None:
        """Check that the head is alive; fast enough to call in a loop.

        Raises:
            HeadLostError: if the head is lost; this process is then disconnected from Ray.
        """

    def close(self) -> None:
        """Stop monitoring the head; this process stays connected to Ray."""


PATIENCE_SECONDS: Final = 20.0  # silence after which a head counts as lost during a campaign's setup, s
CHECK_SECONDS: Final = 1.0  # interval between checks, s
GRACE_SECONDS: Final = 6.0  # grace period for loops that check the head themselves, s

NOT_BEGUN: Final = "no run had been started; give the same command again"

BEGUN: Final = "the same command continues where it was"


@contextmanager
def exit_on_head_loss(
    head: Watched,
    name: str,
    advice: str = NOT_BEGUN,
    *,
    grace: float = 0.0,
    conclude: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Context manager that ends this process with a message and exit code `RAY_LOST` if Ray's head is lost.

    Without a head, a call to Ray blocks uninterruptibly until Ray ends the process silently, after 60 s. The
    block has `grace` seconds to notice the loss and end itself; `conclude` runs last and may not call Ray.
    """
    done = threading.Event()

    def watch() -> None:
        while not done.wait(CHECK_SECONDS):
            if head.failure_reason(PATIENCE_SECONDS) is None or done.wait(grace):
                continue
            reason = head.failure_reason(PATIENCE_SECONDS)
            if reason is not None and not done.is_set():
                try:
                    head.kill()
                    conclude()
                finally:
                    sys.stderr.write(f"{name}: {reason}; {advice}\n")
                    sys.stderr.flush()
                    os._exit(RAY_LOST)

    threading.Thread(target=watch, name="watch-over-ray-head", daemon=True).start()
    try:
        yield
    finally:
        done.set()
