"""Head node of Ray for a test, isolated from other clusters and the user's home."""

import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

PORTS = (
    *("port", "dashboard-port", "dashboard-agent-listen-port", "dashboard-agent-grpc-port"),
    *("runtime-env-agent-port", "metrics-export-port", "ray-client-server-port"),
)

RAY = Path(sys.executable).with_name("ray")


@dataclass(frozen=True)
class Head:
    """Running head node."""

    address: str
    jobs: str  # address of the Jobs API, which needs a dashboard
    environment: dict[str, str]  # with the path of its token


@contextmanager
def local_head(*options: str, dashboard: bool = False) -> Iterator[Head]:
    """Context manager with a head node on free ports and with a new token."""
    place = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
    with place as folder:
        ports = free_ports(len(PORTS))
        environment = private_environment(Path(folder))
        command = [
            *(RAY, "start", "--head", "--block", "--num-cpus=2", "--node-ip-address=127.0.0.1"),
            *(f"--temp-dir={folder}", "--object-store-memory=100000000", "--dashboard-host=127.0.0.1"),
            *(f"--{name}={port}" for name, port in zip(PORTS, ports, strict=True)),
            *(f"--include-dashboard={str(dashboard).lower()}", *options),
        ]
        options = {"env": environment, "start_new_session": True}
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True, **options)
        try:
            assert process.stdout is not None
            assert any("Ray runtime started" in line for line in process.stdout), "no head node"
            yield Head(f"127.0.0.1:{ports[0]}", f"http://127.0.0.1:{ports[1]}", environment)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=60)


def free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


def private_environment(folder: Path) -> dict[str, str]:
    """Return environment variables with the home, the token and Ray's files in `folder`."""
    token = folder / "token"
    token.write_text(secrets.token_hex(32))
    token.chmod(0o600)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    own = {"HOME": str(folder), "RAY_TMPDIR": str(folder), "RAY_AUTH_TOKEN_PATH": str(token)}
    own |= {"RAY_AUTH_MODE": "token", "RAY_USAGE_STATS_ENABLED": "0", "RAY_JOB_STOP_WAIT_TIME_S": "90"}
    return kept | own
