"""Kinds of faults, injected into a campaign repeatedly and at random times until it is finished."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import psutil
from faults import Site, kill, wait_for
from nodes import Nodes
from saboteur import FULL_DISK
from suite.object_server import ObjectServer

from tma_ray.console.exit_codes import FAILED, RAY_LOST
from tma_ray.results import Store

HERE = Path(__file__).parent

LONGEST_WAIT = 1.5
"""Largest random time between a checkpoint and a fault, s; it may cover the next checkpoint."""

LONGEST_START = 300.0
"""Largest time until training continues after a fault, s."""

COHORT_WIDTH, COHORT_CORES = 4, 2
"""Number of slots of a cohort, and of cores of a node that it fits on."""

SHORT_FREEZE = 1.5
"""Duration of a freeze after which a node's runs are not given to other nodes, s."""

SHORT_OUTAGE, LONG_OUTAGE = 2.0, 8.0
"""Shortest and longest outage of an object store, s."""


@dataclass
class Scene:
    """Campaign with injected faults."""

    site: Site
    nodes: Nodes
    chance: random.Random
    times: list[float] = field(default_factory=list)
    since: float = 0.0  # last fault or start of a driver, s since 1970
    drivers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(self, *flags: str) -> subprocess.Popen[bytes]:
        """Start a driver, whose runs are slowed down until `Site.go_on`."""
        self.since = time.time()
        self.drivers.append(self.site.hold(*flags))
        return self.drivers[-1]

    def wait(self) -> None:
        """Wait for a checkpoint after the last fault or start, and then for a random time."""
        wait_for(lambda: self.site.last_checkpoint() > self.since, LONGEST_START)
        time.sleep(self.chance.uniform(0, LONGEST_WAIT))

    def note(self) -> None:
        """Record the time of a fault."""
        self.since = time.time()
        self.times.append(self.since)

    def close(self) -> None:
        """Kill the drivers that a failed attack leaves."""
        for driver in self.drivers:
            driver.kill()
            driver.wait()

    def kill_driver(self, driver: subprocess.Popen[bytes]) -> None:
        """Kill a driver, and wait until its actors have ended."""
        driver.kill()
        driver.wait()
        self.note()
        wait_for(lambda: not self.nodes.workers("SeedActor"))

    def busy_node(self) -> int:
        """Return a random node with a run."""

        def busy() -> list[int]:
            seeds = set(self.nodes.workers("SeedActor"))
            return [number for number in self.nodes.living if self.nodes.processes(number) & seeds]

        wait_for(busy)
        return self.chance.choice(busy())


def driver_killed(scene: Scene, injections: int) -> None:
    """Kill the driver; after the end of its actors, the same command continues the campaign."""
    for _ in range(injections):
        driver = scene.start()
        scene.wait()
        scene.kill_driver(driver)
    scene.site.go_on()


def actor_killed(kind: str) -> Kind:
    """Return a fault: kill a single actor of a kind."""

    def disturb(scene: Scene, injections: int) -> None:
        driver = scene.start()
        for _ in range(injections):
            scene.wait()
            wait_for(lambda: scene.nodes.workers(kind))
            kill(scene.chance.choice(scene.nodes.workers(kind)))
            scene.note()
        scene.site.go_on(driver)

    return disturb


def learner_disturbed(number: signal.Signals) -> Kind:
    """Return a fault: kill or stop the learner of a cohort by a signal."""

    def disturb(scene: Scene, injections: int) -> None:
        node = scene.nodes.add(COHORT_CORES)
        driver = scene.start("--cohort", str(COHORT_WIDTH), "--unreachable-seconds", "10")
        for _ in range(injections):
            scene.wait()
            wait_for(lambda: scene.nodes.workers("LearnerActor"))
            os.kill(scene.chance.choice(scene.nodes.workers("LearnerActor")), number)
            scene.note()
        scene.site.go_on(driver)
        scene.nodes.kill(node)

    return disturb


def node_disturbed(kill: Callable[[Nodes, int], None]) -> Kind:
    """Return the fault that kills processes of a node: all, or the raylet, which its workers outlive."""

    def disturb(scene: Scene, injections: int) -> None:
        driver = scene.start()
        for _ in range(injections):
            scene.wait()
            number = scene.busy_node()
            attempts = scene.site.attempts()
            kill(scene.nodes, number)
            scene.note()
            scene.nodes.add()
            wait_for(lambda attempts=attempts: scene.site.attempts() - attempts, LONGEST_START)
        scene.site.go_on(driver)

    return disturb


def node_frozen(scene: Scene, injections: int) -> None:
    """Freeze a node, and thaw it after a moment or after its runs were given to other nodes."""
    driver = scene.start()
    for _ in range(injections):
        scene.wait()
        number = scene.busy_node()
        attempts = scene.site.attempts()
        given_away = scene.chance.random() < 0.5
        frozen = scene.nodes.freeze(number)
        scene.note()
        try:
            if given_away:
                scene.nodes.add()
                wait_for(lambda attempts=attempts: scene.site.attempts() - attempts, LONGEST_START)
            else:
                time.sleep(SHORT_FREEZE)
        finally:
            scene.nodes.thaw(frozen)
        if given_away:  # the node's processes end, since new attempts have replaced theirs
            wait_for(lambda frozen=frozen: scene.nodes.ended(frozen), LONGEST_START)
            scene.nodes.kill(number)
    scene.site.go_on(driver)


def core_killed(name: str) -> Kind:
    """Return a fault: kill a core process of a Ray that was started by the campaign."""

    def disturb(scene: Scene, injections: int) -> None:
        scene.site = replace(scene.site, address=None)
        for _ in range(injections):
            driver = scene.start()
            scene.wait()
            family = psutil.Process(driver.pid).children(recursive=True)
            (core,) = (process for process in family if process.name() == name)
            core.kill()
            scene.note()
            scene.site.finish(driver, RAY_LOST)
            assert time.time() - scene.times[-1] < 15
            _, left = psutil.wait_procs(family, timeout=5)
            assert left == []
        scene.site.go_on()

    return disturb


def object_store_full(scene: Scene, injections: int) -> None:
    """Overfill the object stores of all nodes by another job."""
    driver = scene.start()
    for _ in range(injections):
        scene.wait()
        command = [sys.executable, str(HERE / "filled_stores.py"), str(scene.site.address)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        with subprocess.Popen(command, env=scene.site.environment, text=True, **pipes) as other:
            assert other.stdout.readline().strip() == "full"
            scene.note()
            scene.wait()
            other.stdin.close()
    scene.site.go_on(driver)


def disk_full(scene: Scene, injections: int) -> None:
    """Fail all writes as on a full disk, until the campaign gives up."""
    for _ in range(injections):
        driver = scene.start("--outage-seconds", "3")
        scene.wait()
        scene.site.ask(FULL_DISK)
        scene.note()
        scene.site.finish(driver, FAILED)
        scene.site.withdraw(FULL_DISK)
    scene.site.go_on()


def root_copied(scene: Scene, injections: int) -> None:
    """Kill the driver, and continue the campaign in a copy of its root."""
    for number in range(injections):
        driver = scene.start()
        scene.wait()
        scene.kill_driver(driver)
        there = scene.site.folder / f"copy-{number}"
        shutil.copytree(scene.site.root, there / "root")
        scene.site = replace(scene.site, folder=there)
    scene.site.go_on()


def checkpoint_damaged(scene: Scene, injections: int) -> None:
    """Kill the driver, and change, cut or remove a file of a newest checkpoint."""
    for _ in range(injections):
        driver = scene.start()
        scene.wait()
        scene.kill_driver(driver)
        index = scene.chance.choice(scene.site.newest_checkpoints())
        file = scene.chance.choice(sorted(path for path in index.parent.rglob("*") if path.is_file()))
        content = file.read_bytes()
        at = scene.chance.randrange(len(content))
        changed = content[:at] + bytes([content[at] ^ (1 << scene.chance.randrange(8))]) + content[at + 1 :]
        damaged = scene.chance.choice((changed, content[:at], None))
        file.unlink() if damaged is None else file.write_bytes(damaged)
    scene.site.go_on()


def object_storage_silent(scene: Scene, injections: int) -> None:
    """Freeze the S3 server of the root for some seconds."""
    with ObjectServer() as server, server.in_environment():
        root = f"s3://{server.bucket}/root"
        environment = {**scene.site.environment, **server.environment}
        scene.site = replace(scene.site, address=None, environment=environment, uri=root)
        driver = scene.start()
        for _ in range(injections):
            scene.wait()
            server.process.send_signal(signal.SIGSTOP)
            scene.note()
            time.sleep(scene.chance.uniform(SHORT_OUTAGE, LONG_OUTAGE))
            server.process.send_signal(signal.SIGCONT)
        scene.site.go_on(driver)
        scene.site.fetch(Store.open(root))


Kind = Callable[[Scene, int], None]

KINDS: Mapping[str, Kind] = {
    "driver": driver_killed,
    "seed_actor": actor_killed("SeedActor"),
    "teacher_actor": actor_killed("TeacherActor"),
    "learner": learner_disturbed(signal.SIGKILL),
    "stopped_learner": learner_disturbed(signal.SIGSTOP),
    "raylet": node_disturbed(Nodes.kill_raylet),
    "node": node_disturbed(Nodes.kill),
    "frozen_node": node_frozen,
    "head": core_killed("raylet"),
    "gcs": core_killed("gcs_server"),
    "object_store": object_store_full,
    "full_disk": disk_full,
    "copied_root": root_copied,
    "checkpoint": checkpoint_damaged,
    "s3": object_storage_silent,
}
"""Kinds of faults by name; functions inject at most the given number of faults, then let the campaign end."""

WIDTHS: Mapping[str, int] = {"learner": COHORT_WIDTH, "stopped_learner": COHORT_WIDTH}
"""Number of slots of cohorts, by kind of fault; in other kinds, runs learn alone."""
