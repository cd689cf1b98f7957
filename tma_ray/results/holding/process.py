"""The process that holds a results root, as other processes of its machine find it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from tma_ray.decoding import SmallNatural


@dataclass(frozen=True)
class Process:
    """A process, as others on its machine can find it.

    Attributes:
        boot: of the machine, a new id after every restart.
        namespace: in which the number is one.
        pid: its number.
    """

    boot: str
    namespace: str
    pid: SmallNatural

    @classmethod
    def this(cls) -> Process | None:
        """Returns this process, None where others could not find it."""
        try:
            boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
            namespace = str(Path("/proc/self/ns/pid").readlink())
        except OSError:
            return None
        return cls(boot, namespace, os.getpid())

    def is_dead(self) -> bool:
        """Tells whether it is known to have ended; one of another machine never is."""
        here = Process.this()
        if here is None or (self.boot, self.namespace) != (here.boot, here.namespace):
            return False
        return not Path(f"/proc/{self.pid}").exists()
