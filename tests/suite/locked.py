"""Versions in the lock files, with which the project is tested and documented."""

from pathlib import Path


def locked(name: str = "requirements.lock") -> dict[str, str]:
    """Return the versions of a lock file by package."""
    lines = (Path(__file__).parents[2] / name).read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if "==" in line)
