"""A place for disturbed campaigns, and the table of what was done to them."""

from __future__ import annotations

import os
import secrets
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

from faults import Fault, Site  # noqa: E402  # from the folders added above
from nodes import Nodes  # noqa: E402

from tma_ray.campaign import Campaign  # noqa: E402

FAULTS: list[Fault] = []


@pytest.fixture(scope="session")
def environment() -> Iterator[dict[str, str]]:
    """Of all processes: no file of Ray's in the user's home, and nobody else's Ray is met."""
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as place:
        requests = Path(place, "requests")
        requests.mkdir()
        kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
        yield kept | {
            "HOME": place,
            "RAY_TMPDIR": place,
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_USAGE_STATS_ENABLED": "0",
            "RAY_worker_niceness": "0",  # else drivers and tests starve the workers on few cores
            "PYTHONPATH": os.pathsep.join([*HELPERS, os.environ.get("PYTHONPATH", "")]),
            "TMA_SABOTAGE": str(requests),
        }


@pytest.fixture(scope="session")
def nodes(environment: dict[str, str]) -> Iterator[Nodes]:
    """A cluster; tests may kill its worker nodes."""
    with Nodes(environment) as nodes:
        yield nodes


@pytest.fixture
def single(tmp_path: Path, environment: dict[str, str], nodes: Nodes) -> Site:
    """The short campaign on a cluster with at least one living worker node."""
    if not nodes.living:
        nodes.add()
    return replace(_site(tmp_path, environment, nodes.address), script="short_campaign.py")


@pytest.fixture
def clustered(tmp_path: Path, environment: dict[str, str], nodes: Nodes) -> Site:
    """A campaign on a cluster with two living worker nodes."""
    while len(nodes.living) < 2:
        nodes.add()
    return _site(tmp_path, environment, nodes.address)


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The data files of the campaign, run by run in this process, without Ray."""
    from chaos_campaign import CAMPAIGN

    return _in_this_process(tmp_path_factory.mktemp("undisturbed"), CAMPAIGN)


@pytest.fixture(scope="session")
def undisturbed_short(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Those of the short one."""
    from short_campaign import SHORT

    return _in_this_process(tmp_path_factory.mktemp("undisturbed"), SHORT)


@pytest.fixture(scope="session")
def faults() -> list[Fault]:
    """Takes what was done and what came of it; shown after the tests."""
    return FAULTS


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the table of faults."""
    if not FAULTS:
        return
    terminalreporter.write_sep("=", "faults")
    terminalreporter.write_line("| fault | injected | rows lost | bytes different | recovery, s |")
    terminalreporter.write_line("|---|---|---|---|---|")
    for fault in FAULTS:
        seconds = " ".join(f"{value:.1f}" for value in fault.recovery_seconds)
        terminalreporter.write_line(
            f"| {fault.name} | {fault.injected} | {fault.rows_lost} | {fault.bytes_different} | {seconds} |"
        )


def _in_this_process(root: Path, campaign: Campaign) -> dict[str, bytes]:
    from small_runs import data_files

    from tma_ray.results import Committer
    from tma_ray.runs import run_locally

    for spec in campaign.plan().runs:
        run_locally(spec, Committer.open(root))
    return data_files(root)


def _site(folder: Path, environment: dict[str, str], address: str) -> Site:
    for left in Path(environment["TMA_SABOTAGE"]).iterdir():
        left.unlink()
    return Site(folder, environment, address)
