"""A checkout with its virtual environment on the machines of a bed."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from bed import KERNELS, REPOSITORY, USER, VENV, Node

PACKAGES = VENV / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"

SMALL = "--evaluation-interval 4000 --probe-interval 2000 --training-window 2000 --memory-per-run 0.5"

FLAGS = f"--teachers random,alp_gmm --seeds 2 --steps 20000 --checkpoint-seconds 1 {SMALL}"

CAMPAIGN = f"experiments/quickstart.py {FLAGS}"
"""Four runs of some ten seconds."""


def copy_checkout(folder: Path, wheel: Path) -> None:
    """Fill a folder with what clusters need of a checkout in which the wheel was built."""
    (folder / "dist").mkdir(parents=True)
    shutil.copy(wheel, folder / "dist")
    for name in ("cluster.lock", "torch.lock"):
        shutil.copy(REPOSITORY / name, folder)
    for name in ("docs", "experiments", "examples"):
        shutil.copytree(REPOSITORY / name, folder / name)


def lend_environment(node: Node) -> None:
    """Let the node's user change the virtual environment, as its own, and find it in ``~/venv``.

    What the cluster's files install is there, in the same versions: no package index is needed. Kernels are
    compiled once for all beds.
    """
    node.run(
        f"chown -R {USER}: {VENV}/bin {PACKAGES}/*tma_ray*; chown {USER}: {PACKAGES}; "
        f"ln -sfn {VENV} ~{USER}/venv; "
        f"echo 'export NUMBA_CACHE_DIR={KERNELS} PYTHONDONTWRITEBYTECODE=1' > /etc/profile.d/kernels.sh",
        user="root",
    )
