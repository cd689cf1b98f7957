"""The machine from which Ray's cluster launcher is called."""

from __future__ import annotations

import subprocess
from pathlib import Path

from bed import USER, VENV, Node
from checkout import copy_checkout

ACTIVE = f"export PATH={VENV}/bin:$PATH RAY_AUTH_MODE=token RAY_USAGE_STATS_ENABLED=0; cd ~/checkout; "


class Laptop:
    """The machine of somebody who has a checkout, with its wheel built, and a key for all nodes.

    Args:
        node: of a bed, which is on.
        wheel: of the checkout.
    """

    def __init__(self, node: Node, wheel: Path) -> None:
        self._node = node
        self._checkout = node.folder / "root" / "home" / USER / "checkout"
        copy_checkout(self._checkout, wheel)
        self._node.run(f"chown -R {USER}: ~{USER}", user="root")
        self.run("pip install --quiet --no-deps --force-reinstall dist/*.whl")
        self.run("umask 077; ray get-auth-token --generate > /dev/null; chmod 600 ~/.ray/auth_token")

    def write(self, name: str, text: str) -> None:
        """Writes a file of the checkout."""
        (self._checkout / name).write_text(text)

    def start(self, command: str) -> subprocess.Popen[str]:
        """Starts a command in the checkout; see `Node.start_process`."""
        return self._node.start_process(ACTIVE + command)

    def run(self, command: str, *, timeout: float = 1800, code: int | None = 0, shown: bool = True) -> str:
        """Runs a command in the checkout, whose virtual environment is active; see `Node.run`."""
        return self._node.run(ACTIVE + command, timeout=timeout, code=code, shown=shown)
