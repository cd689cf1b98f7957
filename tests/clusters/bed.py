"""Test bed of virtual machines ("nodes") made of Linux namespaces, with separate networks and sshd.

A node is a set of namespaces. Its file system is this machine's, with private changes (overlays). Its only
network is a bridge in separate namespaces: this machine's network is unchanged, and all mounts end with the
processes. Needs Linux, root, and the programs in `PROGRAMS`.

By hand, until Enter is pressed::

    python tests/clusters/bed.py head one two
"""

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

REPOSITORY = Path(__file__).parents[2]
VENV = Path(sys.prefix).resolve()
PROGRAMS = ("ip", "nsenter", "pivot_root", "rsync", "setpriv", "sshd", "tmux", "unshare")

KERNELS = Path("/var/tmp/clusters-kernels")
"""Compiled kernels, shared by all beds, since their compilation takes minutes on a busy machine."""

NETWORK = "10.77.0"
"""First three numbers of the addresses, which are private to the bed."""

USER = "ubuntu"
"""Name of the user of every node, as in images of Ubuntu."""

SEARCHED = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


def missing() -> str | None:
    """Return the reason why this machine cannot have a bed, or None."""
    if platform.system() != "Linux" or os.geteuid() != 0:
        return "nodes are namespaces of Linux, which root makes"
    lacking = [each for each in PROGRAMS if shutil.which(each, path=SEARCHED) is None]
    return f"needs the programs {', '.join(lacking)}" if lacking else None


@dataclass
class Node:
    """Machine of the bed."""

    name: str
    address: str
    folder: Path  # of this machine, with the changes of the node's file system
    public: str = ""  # second address, if it has one
    _process: subprocess.Popen[bytes] | None = None
    _init: int = 0

    def start(self, switch: int, paths: Sequence[str]) -> None:
        """Start the node, keeping earlier changes of its files, and wait for its sshd."""
        self.folder.mkdir(exist_ok=True)
        enter = ["nsenter", f"--target={switch}", "--net", "--mount", "--pid"]
        apart = ["unshare", "--net", "--mount", "--pid", "--uts", "--ipc", "--fork", "--kill-child"]
        script = ["bash", str(Path(__file__).with_name("node.sh")), str(self.folder), self.name]
        with (self.folder / "console.log").open("ab") as log:
            self._process = subprocess.Popen(
                [*enter, *apart, *script, f"{self.address} {self.public}", *paths],
                env={"PATH": SEARCHED}, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip
        deadline = time.monotonic() + 60
        while "listening on" not in (self.folder / "console.log").read_text().rpartition("Terminated")[2]:
            assert self._process.poll() is None, (self.folder / "console.log").read_text()
            assert time.monotonic() < deadline, f"{self.name} did not start"
            time.sleep(0.1)
        (unshared,) = psutil.Process(self._process.pid).children()
        (init,) = unshared.children()
        self._init = init.pid

    def power_off(self) -> None:
        """End all processes of the node at once."""
        os.kill(self._init, signal.SIGKILL)
        self._process.wait(timeout=60)
        with (self.folder / "console.log").open("a") as log:
            log.write("Terminated\n")

    def start_process(self, command: str, user: str = USER) -> subprocess.Popen[str]:
        """Start a shell command in the user's home; errors go to its standard output."""
        return subprocess.Popen(
            [*self._entering(user), "--command", command],
            env={"PATH": SEARCHED, "TERM": "xterm"}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def run(
        self,
        command: str,
        *,
        user: str = USER,
        timeout: float = 1800,
        code: int | None = 0,
        shown: bool = True,  # with its output and duration, as failures show
    ) -> str:
        """Run a shell command, and return its output."""
        start = time.monotonic()
        process = self.start_process(command, user)
        try:
            output, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            raise AssertionError(f"{self.name}$ {command}\n{process.communicate()[0]}") from None
        transcript = f"{self.name}$ {command}\n{output}"
        if shown:
            ended = f"{time.strftime('%H:%M:%S')}, after {time.monotonic() - start:.0f} s"
            sys.stdout.write(f"{ended}: {transcript}\n")
        assert code is None or process.returncode == code, f"exit code {process.returncode}: {transcript}"
        return output

    @property
    def login(self) -> str:
        """Shell command of this machine that opens a shell on the node."""
        return shlex.join(self._entering(USER))

    def write(self, path: str, text: str) -> None:
        """Write a file as root."""
        self.run(f"printf %s {shlex.quote(text)} > {path}", user="root", shown=False)

    def _entering(self, user: str) -> list[str]:
        namespaces = ["--net", "--mount", "--pid", "--uts", "--ipc", "--root", "--wd=/"]
        return ["nsenter", f"--target={self._init}", *namespaces, "su", "--login", user]


def wait_until(happened: Callable[[], object], seconds: float) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, f"not within {seconds:.0f} s"
        time.sleep(1)


class Bed:
    """Nodes on one network bridge, with a shared folder ``/shared``."""

    def __init__(self, folder: Path, names: Sequence[str], paths: Sequence[str]) -> None:
        self._paths = paths  # folders of this machine that nodes mount; see node.sh
        self.shared = folder / "shared"
        numbered = enumerate(names, 10)
        self.nodes = {name: Node(name, f"{NETWORK}.{n}", folder / name) for n, name in numbered}
        private = self.shared / ".bed"
        private.mkdir(parents=True)
        self.shared.chmod(0o1777)
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", private / "key"], check=True)
        lines = ["127.0.0.1 localhost", *(f"{node.address} {node.name}" for node in self.nodes.values())]
        (private / "hosts").write_text("\n".join([*lines, ""]))
        bridge = (
            "ip link add bridge type bridge && ip link set bridge up && echo ready && exec sleep infinity"
        )
        self._process = subprocess.Popen(
            ["setpriv", "--pdeathsig", "KILL", "unshare", "--net", "--mount", "--pid", "--fork",
             "--kill-child", "--mount-proc", "bash", "-c", bridge],
            env={"PATH": SEARCHED}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout.readline() == "ready\n", "no bridge"
        (first,) = psutil.Process(self._process.pid).children()
        self._switch = first.pid

    def on(self, *names: str, paths: Sequence[str] | None = None) -> list[Node]:
        """Start nodes; return them."""
        nodes = [self.nodes[name] for name in names]
        for node in nodes:
            node.start(self._switch, self._paths if paths is None else paths)
        return nodes

    def add(self, name: str, address: str, public: str) -> Node:
        """Add and start a node with two addresses; return it."""
        self.nodes[name] = Node(name, address, self.shared.parent / name, public)
        return self.on(name)[0]

    def close(self) -> None:
        """Kill all nodes and the network."""
        os.kill(self._switch, signal.SIGKILL)
        self._process.wait(timeout=60)


@contextmanager
def bed_of(*names: str) -> Iterator[Bed]:
    """Context manager with a bed whose nodes have copies of this checkout and its virtual environment."""
    folder = Path(tempfile.mkdtemp(prefix="clusters-", dir="/var/tmp"))
    KERNELS.mkdir(exist_ok=True)
    KERNELS.chmod(0o1777)
    paths = [f"read:{sys.base_prefix}", f"read:{REPOSITORY}", f"own:{VENV}", f"write:{KERNELS}"]
    bed = Bed(folder, names, paths)
    try:
        yield bed
    finally:
        bed.close()
        shutil.rmtree(folder, ignore_errors=True)


def main(names: Sequence[str]) -> None:
    """Start the named nodes, print the commands that open shells on them, and stop them after Enter."""
    reason = missing()
    if reason or not names:
        sys.exit(reason or "name the nodes, such as: head one two")
    with bed_of(*names) as bed:
        for node in bed.on(*names):
            sys.stdout.write(f"{node.name}, {node.address}: {node.login}\n")
        sys.stdout.write(f"/shared is {bed.shared}; Enter takes the nodes away\n")
        sys.stdin.readline()


if __name__ == "__main__":
    main(sys.argv[1:])
