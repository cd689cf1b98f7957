"""Server and picklable handles of a curriculum that several processes share."""

import os
import secrets
from collections.abc import Callable
from multiprocessing import AuthenticationError
from multiprocessing.connection import Client, Connection, Listener
from threading import Lock, Thread
from typing import Any

from tma_ray.curriculum.episodes import Apply, Array, Assignment, Environment, Link, PlayedEpisode
from tma_ray.curriculum.wrappers import CurriculumEnvironment
from tma_ray.tasks import TaskSpace

BACKLOG = 256  # number of processes that may connect at the same time


class CurriculumServer:
    """Server of a curriculum for handles in other processes, with one thread per process.

    Episodes of a process that dies are abandoned. `host` is the name or address of this machine for other
    machines, None for a local socket.
    """

    def __init__(self, link: Link, host: str | None = None) -> None:
        self._link = link
        self.key = secrets.token_bytes(32)
        address = None if host is None else (host, 0)
        self._listener = Listener(address, backlog=BACKLOG, authkey=self.key)
        self.address = self._listener.address
        Thread(target=self._accept, name="tma_ray curriculum", daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection = self._listener.accept()
            except (OSError, EOFError, AuthenticationError):  # a process failed to connect
                continue
            Thread(target=self._serve, args=(connection,), name="tma_ray curriculum", daemon=True).start()

    def _serve(self, connection: Connection) -> None:
        begun: set[int] = set()
        try:
            while True:
                method, arguments = connection.recv()
                try:
                    result = getattr(self._link, method)(*arguments)
                except Exception as error:  # sent to the calling process, which raises it
                    connection.send((False, f"{type(error).__name__}: {error}"))
                    continue
                if method == "begin":
                    begun.add(result.number)
                elif method in ("end", "abandon"):
                    begun.discard(getattr(arguments[0], "number", arguments[0]))
                connection.send((True, result))
        except (EOFError, OSError):  # the process has ended
            pass
        finally:
            for number in begun:
                self._link.abandon(number)
            connection.close()


class SharedCurriculum:
    """Picklable handle of a curriculum for use in other processes, including forked ones.

    Created by `Curriculum.shared`. It connects on first use to the process of the curriculum, which must be
    alive.
    """

    def __init__(
        self,
        address: Any,
        key: bytes,
        space: TaskSpace,
        gamma: float,
        mastery_return: float,
        marks_withheld: bool,
    ) -> None:
        self._address, self._key = address, key
        self.space, self.gamma, self.mastery_return = space, gamma, mastery_return
        self.marks_withheld = marks_withheld
        self._lock, self._connections = Lock(), dict[int, Connection]()

    def wrap(self, environment: Environment, apply: Apply | None = None) -> CurriculumEnvironment:
        """Wrap `environment` to take tasks from the curriculum; see `Curriculum.wrap`."""
        return CurriculumEnvironment(environment, self, apply)

    def begin(self) -> Assignment:
        """Start the next episode and return its assignment."""
        assignment: Assignment = self._call("begin")
        return assignment

    def end(self, played: PlayedEpisode) -> None:
        """Report a finished episode."""
        self._call("end", played)

    def abandon(self, number: int) -> None:
        """Discard the episode `number` without reporting it."""
        self._call("abandon", number)

    def act(self, observations: Array) -> Array:
        """Return actions (n, a) of the exploring policy for observations (n, o)."""
        actions: Array = self._call("act", observations)
        return actions

    def _call(self, method: str, *arguments: Any) -> Any:
        with self._lock:
            connection = self._connections.get(os.getpid())
            if connection is None:
                connection = self._connections[os.getpid()] = Client(self._address, authkey=self._key)
            connection.send((method, arguments))
            succeeded, result = connection.recv()
        if not succeeded:
            raise RuntimeError(f"the curriculum refused this: {result}")
        return result

    def __reduce__(self) -> tuple[Callable[..., "SharedCurriculum"], tuple[Any, ...]]:
        settings = self.space, self.gamma, self.mastery_return, self.marks_withheld
        return SharedCurriculum, (self._address, self._key, *settings)
