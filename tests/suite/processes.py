"""Python in a new process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def python(*arguments: str | Path, cwd: Path | None = None, **variables: str) -> str:
    """Return what a new process prints.

    Raises:
        CalledProcessError: it failed.
    """
    command, environment = [sys.executable, *map(str, arguments)], os.environ | variables
    ended = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=True)
    return ended.stdout
