"""`cluster-local.yaml` on machines that have Python and nothing of this project: all is installed."""

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from bed import bed_of
from checkout import CAMPAIGN, lend_environment, locked_packages
from launcher import FILE, Laptop
from small_runs import rows

from tma_ray.results import Table

PYTHON = "/usr/bin/python3"
"""The system's Python, all that the machines have."""


def system_python() -> str:
    """Return the version of the system's Python if it makes virtual environments, else nothing."""
    look = "import ensurepip, sys; print('.'.join(map(str, sys.version_info[:2])))"
    try:
        return subprocess.run([PYTHON, "-c", look], capture_output=True, text=True).stdout.strip()
    except FileNotFoundError:
        return ""


@pytest.mark.skipif(not system_python(), reason=f"{PYTHON} has no venv (Debian's python3-venv)")
def test_machines_with_nothing_but_python_are_a_cluster_after_one_command(wheel: Path) -> None:
    wheels = locked_packages(system_python())
    with bed_of("laptop", "head", "worker") as bed:
        (node,) = bed.on("laptop")
        head, worker = bed.on("head", "worker", paths=[f"read:{wheels}"])
        for bare in (head, worker):
            bare.write("/etc/pip.conf", f"[global]\nno-index = true\nfind-links = {wheels}\n")
            assert "No module named" in bare.run("python3 -c 'import ray'", code=1)
        lend_environment(node)
        laptop = Laptop(node, wheel)
        start = datetime.now(UTC)
        laptop.up(head, [worker])
        joined = datetime.now(UTC)
        output = laptop.run(f"ray submit {FILE} {CAMPAIGN} --address auto --results /shared/bare")
        assert "4/4 runs done" in output
        attempts = rows(bed.shared / "bare", Table.ATTEMPTS)
        assert len({row["host"] for row in attempts}) == 2
        first = min(row["started_at"] for row in attempts)
        sys.stdout.write(f"from ray up to all machines: {joined - start}, to a first run: {first - start}\n")
        assert "+cpu" in head.run("du -sh ~/venv; ~/venv/bin/pip freeze | grep torch")
        laptop.run(f"ray down --yes {FILE}")
