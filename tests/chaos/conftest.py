"""Fixtures of the chaos tests: clusters, undisturbed results, and a table of faults."""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

HERE = Path(__file__).parent
HELPERS = [str(HERE), str(HERE.parent / "runs")]
for folder in HELPERS:
    if folder not in sys.path:
        sys.path.insert(0, folder)

# Imported from the folders added above:
from faults import Check, Compare, Fault, Site, private_environment, table, undisturbed_files  # noqa: E402
from nodes import Nodes  # noqa: E402

FAULTS: list[Fault] = []


@pytest.fixture(scope="session")
def environment() -> Iterator[dict[str, str]]:
    """Environment variables of all processes, isolated from other clusters and the user's home."""
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as place:
        yield private_environment(Path(place))


@pytest.fixture(scope="session")
def nodes(environment: dict[str, str]) -> Iterator[Nodes]:
    """Cluster whose worker nodes may be killed by tests."""
    with Nodes(environment) as nodes:
        yield nodes


@pytest.fixture
def single(tmp_path: Path, environment: dict[str, str], nodes: Nodes) -> Site:
    """Short campaign on a cluster with at least one live worker node."""
    if not nodes.living:
        nodes.add()
    return replace(_site(tmp_path, environment, nodes.address), script="short_campaign.py")


@pytest.fixture
def clustered(tmp_path: Path, environment: dict[str, str], nodes: Nodes) -> Site:
    """Campaign on a cluster with at least two live worker nodes."""
    while len(nodes.living) < 2:
        nodes.add()
    return _site(tmp_path, environment, nodes.address)


@pytest.fixture(scope="session")
def undisturbed() -> dict[str, bytes]:
    """Data files of the undisturbed campaign, executed in this process without Ray."""
    return undisturbed_files()


@pytest.fixture(scope="session")
def undisturbed_short() -> dict[str, bytes]:
    return undisturbed_files("short_campaign", "SHORT")


@pytest.fixture(scope="session")
def check() -> Check:
    """Function that checks that a fault lost nothing, and adds it to the final table."""

    def look(fault: Fault) -> None:
        FAULTS.append(fault)
        assert (fault.rows_lost, fault.bytes_different) == (0, 0)

    return look


@pytest.fixture
def compare(clustered: Site, undisturbed: dict[str, bytes], check: Check) -> Compare:
    """Function that compares the clustered campaign with the undisturbed one, and checks the fault."""

    def look(name: str, times: list[float], injected: int = 1) -> None:
        check(clustered.compare(name, injected, undisturbed, times))

    return look


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if FAULTS:
        terminalreporter.write_sep("=", "faults")
        terminalreporter.write_line(table(FAULTS))


def _site(folder: Path, environment: dict[str, str], address: str) -> Site:
    for left in Path(environment["TMA_SABOTAGE"]).iterdir():
        left.unlink()
    return Site(folder, environment, address)
