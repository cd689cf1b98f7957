"""Processor seconds of every case, with those of the processes that it starts, slowest first.

Wall time tells of neighbours on the machine too; processor time of the case alone.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

TOLERATED = 3.0
"""Processor seconds above which a case belongs into a slower tier, or wants a look."""

TIERS = ("slow", "chaos")

READING = pytest.StashKey[float]()

TICKS = os.sysconf("SC_CLK_TCK")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --costs."""
    parser.addoption("--costs", type=int, default=0, metavar="N", help="list the N slowest cases at the end")


def pytest_configure(config: pytest.Config) -> None:
    """Collect the costs of all processes where reports come together."""
    if config.getoption("--costs") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(CostReport(config.getoption("--costs")))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Read the clock before the first case."""
    session.config.stash[READING] = processor_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Send the seconds since the case before along with the last report of a case.

    A fixture of larger scope falls to the case that is first to ask. One reading a case: each asks the system
    for every thread of every process that this one has started.
    """
    report = yield
    if call.when == "teardown":
        before, item.config.stash[READING] = item.config.stash[READING], processor_seconds()
        report.processor_seconds = max(0.0, item.config.stash[READING] - before)
    return report


class CostReport:
    """The list at the end of a session."""

    def __init__(self, length: int) -> None:
        self.length = length
        self.costs: list[tuple[float, str]] = []
        self.unmarked: list[tuple[float, str]] = []

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note the cost of a case."""
        if report.when == "teardown":
            self.costs.append((report.processor_seconds, report.nodeid))
            if report.processor_seconds > TOLERATED and not set(TIERS) & set(report.keywords):
                self.unmarked.append((report.processor_seconds, report.nodeid))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the slowest, then those that no marker admits."""
        write = terminalreporter.write_line
        total = sum(seconds for seconds, _ in self.costs)
        terminalreporter.write_sep("=", f"the slowest of {total:.0f} processor seconds in cases")
        for seconds, name in sorted(self.costs, reverse=True)[: self.length]:
            write(f"{seconds:7.2f} s {name}")
        if self.unmarked:
            write(f"over {TOLERATED:g} s without the marker {' or '.join(TIERS)}:")
        for seconds, name in sorted(self.unmarked, reverse=True):
            write(f"{seconds:7.2f} s {name}")


def processor_seconds() -> float:
    """Return what this process and its children, ended or alive, have used, in seconds."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    alive = sum(_used(process) for process in _descendants("self"))
    return time.process_time() + ended.ru_utime + ended.ru_stime + alive


def _descendants(process: str) -> Iterator[str]:
    """Yield the living children of a process and theirs; none where the system has no /proc."""
    children: list[str] = []
    with suppress(OSError):
        for thread in Path("/proc", process, "task").iterdir():
            children += (thread / "children").read_text().split()
    for child in children:
        yield child
        yield from _descendants(child)


def _used(process: str) -> float:
    with suppress(OSError):
        fields = Path("/proc", process, "stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / TICKS  # user, system, and both of ended children
    return 0.0
