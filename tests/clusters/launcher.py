"""Machine of a user who calls Ray's cluster launcher."""

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from bed import REPOSITORY, USER, VENV, Node, wait_until
from checkout import copy_checkout

FILE = "cluster-local.yaml"
ACTIVE = f"export PATH={VENV}/bin:$PATH RAY_AUTH_MODE=token RAY_USAGE_STATS_ENABLED=0; cd ~/checkout; "


class Laptop:
    """Machine of a user with a checkout, a built wheel, and a key for all nodes."""

    def __init__(self, node: Node, wheel: Path) -> None:
        self._node = node
        self._checkout = node.folder / "root" / "home" / USER / "checkout"
        copy_checkout(self._checkout, wheel)
        self._node.run(f"chown -R {USER}: ~{USER}", user="root")
        self.run("pip install --quiet --no-deps --force-reinstall dist/*.whl")
        self.run("umask 077; ray get-auth-token --generate > /dev/null; chmod 600 ~/.ray/auth_token")

    def write(self, name: str, text: str) -> None:
        """Write a file of the checkout."""
        (self._checkout / name).write_text(text)

    def up(self, head: Node, workers: Sequence[Node]) -> None:
        """Fill in `FILE`, call `ray up`, and wait until all nodes have joined."""
        text = (REPOSITORY / FILE).read_text()
        addresses = ", ".join(worker.address for worker in workers)
        for line, filled in {
            "head_ip: 192.168.1.10": f"head_ip: {head.address}",
            "worker_ips: [192.168.1.11, 192.168.1.12]": f"worker_ips: [{addresses}]",
            "ssh_user: you": f"ssh_user: {USER}",
        }.items():
            assert text.count(line) == 1
            text = text.replace(line, filled)
        self.write(FILE, text)
        self.run(f"ray up --yes {FILE}")
        self.wait_for_workers(len(workers))

    def wait_for_workers(self, count: int) -> None:
        """Wait until the head and `count` workers have joined."""

        def nodes() -> int:
            there, _, _ = self.run(f"ray exec {FILE} 'ray status'", shown=False).partition("Pending:")
            found = re.findall(r"^ (\d+) local\.cluster\.node", there, re.MULTILINE)
            return sum(int(number) for number in found)

        wait_until(lambda: nodes() == 1 + count, 1200)

    def start(self, command: str) -> subprocess.Popen[str]:
        """Start a command in the checkout; see `Node.start_process`."""
        return self._node.start_process(ACTIVE + command)

    def run(self, command: str, *, timeout: float = 1800, code: int | None = 0, shown: bool = True) -> str:
        """Run a command in the checkout with its virtual environment; see `Node.run`."""
        return self._node.run(ACTIVE + command, timeout=timeout, code=code, shown=shown)
