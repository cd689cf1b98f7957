"""A head that is lost while a campaign is checked ends the driver at once, with a message."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

from tma_ray.commands.exits import RAY_LOST

DRIVER = """
    import time
    from tma_ray.campaign.cluster.base import leaving_without_head

    class Head:
        def lost(self, patience):
            return "the head is gone" if HEAD_IS_LOST else None

        def abandon(self):
            print("abandoned", flush=True)

    with leaving_without_head(Head(), "short"):
        time.sleep(WAIT)
    print("checked")
"""


def driver(wait: float, *, lost: bool) -> subprocess.CompletedProcess[str]:
    code = textwrap.dedent(DRIVER).replace("HEAD_IS_LOST", str(lost)).replace("WAIT", str(wait))
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_lost_head_ends_the_driver_with_a_message() -> None:
    ended = driver(1000, lost=True)
    assert (ended.returncode, ended.stdout) == (RAY_LOST, "abandoned\n")
    assert ended.stderr == ("short: the head is gone; no run had been started; give the same command again\n")


def test_a_head_that_is_there_is_left_alone() -> None:
    ended = driver(0, lost=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "checked\n", "")
