"""Copy of this checkout and its virtual environment on the nodes of a test bed."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

from bed import KERNELS, REPOSITORY, USER, VENV, Node
from small_runs import data_files, rows

from tma_ray.results import Table

WHEELS = Path("/var/tmp/clusters-wheels")
"""Cached packages for nodes without access to a package index."""

PACKAGES = VENV / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
SMALL = "--evaluation-interval 4000 --probe-interval 2000 --training-window 2000 --memory-per-run 0.5"
FLAGS = f"--teachers random,alp_gmm --seeds 2 --steps 20000 --checkpoint-seconds 1 {SMALL}"

CAMPAIGN = f"experiments/quickstart.py {FLAGS}"
"""Campaign of four runs of about ten seconds."""


def locked_packages(python: str) -> Path:
    """Download the packages of both lock files for a Python version (torch for CPUs); return the folder."""
    (index,) = set(re.findall(r"--index-url \S+", (REPOSITORY / "cluster-local.yaml").read_text()))
    download = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:",
                f"--python-version={python}", f"--dest={WHEELS}"]  # fmt: skip
    subprocess.run([*download, "--requirement", REPOSITORY / "cluster.lock"], check=True)
    subprocess.run([*download, *index.split(), "--requirement", REPOSITORY / "torch.lock"], check=True)
    return WHEELS


def copy_checkout(folder: Path, wheel: Path) -> None:
    """Copy the files of a checkout that clusters need, with a built wheel, to a folder."""
    (folder / "dist").mkdir(parents=True)
    shutil.copy(wheel, folder / "dist")
    for name in ("cluster.lock", "torch.lock"):
        shutil.copy(REPOSITORY / name, folder)
    for name in ("docs", "experiments", "examples"):
        shutil.copytree(REPOSITORY / name, folder / name)


def lend_environment(node: Node) -> None:
    """Give the node's user write access to the virtual environment, and a link to it, ``~/venv``.

    It has the packages that the cluster's files install, in the same versions, so no package index is needed.
    Kernels are compiled once for all beds.
    """
    node.run(
        f"chown -R {USER}: {VENV}/bin {PACKAGES}/*tma_ray*; chown {USER}: {PACKAGES}; "
        f"ln -sfn {VENV} ~{USER}/venv; "
        f"echo 'export NUMBA_CACHE_DIR={KERNELS} PYTHONDONTWRITEBYTECODE=1' > /etc/profile.d/kernels.sh",
        user="root",
    )


def tables(root: str | Path) -> dict[str, str]:
    """Return the tables of a root except that of attempts, which has hosts and times."""
    found = {path: hashlib.sha256(data).hexdigest() for path, data in data_files(root).items()}
    for table in (Table.RUNS, Table.CELLS):
        found[table.value] = "\n".join(sorted(json.dumps(row, sort_keys=True) for row in rows(root, table)))
    return found
