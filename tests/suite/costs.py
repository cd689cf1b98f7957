"""Plug-in that lists the processor seconds of cases and their child processes, slowest first.

Unlike wall time, processor time does not depend on other processes of the machine.
"""

import os
import resource
import time
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

TOLERATED = 3.0
"""Processor seconds above which a case should be faster, or in a slower tier."""

TIERS = ("slow", "chaos")
READING = pytest.StashKey[float]()
TICKS = os.sysconf("SC_CLK_TCK")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option --costs."""
    parser.addoption("--costs", type=int, default=0, metavar="N", help="list the N slowest cases at the end")


def pytest_configure(config: pytest.Config) -> None:
    """Register the report in the main process."""
    if config.getoption("--costs") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(CostReport(config.getoption("--costs")))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Store the processor time spent before the first case."""
    session.config.stash[READING] = processor_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the seconds since the previous case to the last report of a case.

    A fixture of larger scope counts to the first case that requests it. There is one reading per case, since
    a reading asks the system for all threads of all child processes.
    """
    report = yield
    if call.when == "teardown":
        before, item.config.stash[READING] = item.config.stash[READING], processor_seconds()
        report.processor_seconds = max(0.0, item.config.stash[READING] - before)
    return report


class CostReport:
    """List of costs at the end of a session."""

    def __init__(self, length: int) -> None:
        self.length = length
        self.costs: list[tuple[float, str]] = []
        self.unmarked: list[tuple[float, str]] = []

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Record the cost of a case."""
        if report.when == "teardown":
            self.costs.append((report.processor_seconds, report.nodeid))
            if report.processor_seconds > TOLERATED and not set(TIERS) & set(report.keywords):
                self.unmarked.append((report.processor_seconds, report.nodeid))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the slowest cases, then slow ones without a marker."""
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
    """Return the processor time of this process and all of its children, in s."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    alive = sum(_used(process) for process in _descendants("self"))
    return time.process_time() + ended.ru_utime + ended.ru_stime + alive


def _descendants(process: str) -> Iterator[str]:
    """Yield the live descendants of a process; none without /proc."""
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
        return sum(map(int, fields[11:15])) / TICKS  # user and system time, and those of ended children
    return 0.0
