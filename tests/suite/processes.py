"""Python in a new process."""

import os
import subprocess
import sys
from pathlib import Path


def python(*arguments: str | Path, cwd: Path | None = None, **variables: str) -> str:
    """Run Python in a new process, and return its output."""
    command, environment = [sys.executable, *map(str, arguments)], os.environ | variables
    ended = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=True)
    return ended.stdout
