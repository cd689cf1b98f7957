"""Cluster on this machine whose nodes can be added, killed, frozen and thawed, in a separate process.

Ray has one connection per process, which tests of other folders use.
"""

import itertools
import multiprocessing
import os
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from unittest import mock

import psutil

HEALTH = {
    "health_check_initial_delay_ms": 1000,
    "health_check_period_ms": 500,
    "health_check_timeout_ms": 1000,
    "health_check_failure_threshold": 4,
}
"""Settings of Ray with which a frozen node counts as dead after about 6 s instead of a minute."""

OBJECT_STORE_BYTES = 80_000_000


class Nodes:
    """Cluster with a head node without CPUs, and worker nodes by number."""

    def __init__(self, environment: dict[str, str]) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, environment))
        with mock.patch.dict(os.environ, environment):  # Ray reads some variables at import
            self._process.start()
        theirs.close()
        self.address: str = self._connection.recv()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.send(("shut_down",))
        self._process.join(60)
        self._process.kill()

    def add(self, cpus: int = 1) -> int:
        """Start a worker node; return its number."""
        return int(self._ask("add", cpus))

    def kill(self, number: int) -> None:
        processes = self.processes(number)
        self._ask("kill", number)
        _signal(processes, signal.SIGKILL)

    def kill_raylet(self, number: int) -> None:
        """Kill the raylet of a node, but not its workers."""
        self._ask("kill", number)

    def freeze(self, number: int) -> set[int]:
        """Stop all processes of a node; return their ids."""
        processes = self.processes(number)
        _signal(processes, signal.SIGSTOP)
        return processes

    def thaw(self, processes: set[int]) -> None:
        _signal(processes, signal.SIGCONT)

    def ended(self, processes: set[int]) -> bool:
        """Return True if all of these processes have ended.

        A raylet whose parent does not wait for it stays a zombie, which its workers consider alive.
        """
        self._ask("reap")
        return not living(processes)

    def processes(self, number: int) -> set[int]:
        """Return the ids of all processes of a node: raylet, agents and workers."""
        raylet = int(self._ask("raylet", number))
        return {raylet} | descendants(raylet)

    def workers(self, kind: str) -> list[int]:
        """Return the ids of this cluster's actor processes of a kind, by the titles that Ray sets."""
        family = set().union(*map(self.processes, self.living))
        return sorted(pid for pid in family if _title(pid).startswith(f"ray::{kind}"))

    @property
    def living(self) -> list[int]:
        """Numbers of the live worker nodes."""
        living: list[int] = self._ask("living")
        return living

    def _ask(self, *request: Any) -> Any:
        self._connection.send(request)
        answer = self._connection.recv()
        if isinstance(answer, Exception):
            raise answer
        return answer


def descendants(pid: int) -> set[int]:
    with suppress(psutil.NoSuchProcess):
        return {child.pid for child in psutil.Process(pid).children(recursive=True)}
    return set()


def living(processes: set[int]) -> set[int]:
    """Return the processes that have not ended."""
    found = set()
    for pid in processes:
        try:
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                found.add(pid)
        except psutil.NoSuchProcess:
            continue
    return found


def _title(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""


def _signal(processes: set[int], number: signal.Signals) -> None:
    for pid in processes:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            continue


def _serve(connection: Connection, environment: dict[str, str]) -> None:
    os.environ.update(environment)
    from ray.cluster_utils import Cluster

    common = {"object_store_memory": OBJECT_STORE_BYTES, "include_dashboard": False}
    head = {"num_cpus": 0, "_system_config": HEALTH, **common}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    nodes: dict[int, Any] = {}
    connection.send(cluster.address)
    while True:
        try:
            name, *arguments = connection.recv()
        except EOFError:  # the parent process has ended
            name, arguments = "shut_down", []
        try:
            if name == "shut_down":
                cluster.shutdown()
                return
            connection.send(_do(cluster, nodes, name, *arguments))
        except Exception as error:
            connection.send(RuntimeError(repr(error)))


def _do(cluster: Any, nodes: dict[int, Any], name: str, *arguments: int) -> Any:
    if name == "add":
        number = max(nodes, default=-1) + 1
        nodes[number] = cluster.add_node(num_cpus=arguments[0], object_store_memory=OBJECT_STORE_BYTES)
        return number
    if name == "raylet":
        return nodes[arguments[0]].all_processes["raylet"][0].process.pid
    if name == "kill":
        cluster.remove_node(nodes[arguments[0]], allow_graceful=False)
        nodes[arguments[0]] = None
        return None
    alive = {number: node for number, node in nodes.items() if node is not None}
    if name == "reap":
        for node in alive.values():
            for started in itertools.chain.from_iterable(node.all_processes.values()):
                started.process.poll()
    return list(alive)
