"""Publishing a release at an address: an object store, or whatever else fsspec can write to."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from analysis.baselines.manifest import BASELINE_FILE, FOREIGN_FILES, BaselineError, BaselineManifest
from analysis.baselines.verification import verify
from tma_ray.results import Store


def publish(folder: str | Path, address: str) -> str:
    """Copies a release from a disk to an address, then reads all of it back and compares the checksums.

    Its ``baseline.json`` comes last: what has none is not a release. An upload that was interrupted is
    continued by the same call.

    Args:
        folder: of the release.
        address: of the release, such as ``s3://bucket/mine-1.0`` or ``hf://datasets/me/mine-1.0``.

    Returns:
        The address.

    Raises:
        BaselineError: the folder is not a release, or a damaged one, or `check_address` refuses the address.
        ObjectStoreError: as `check_address` says, or the upload fails.
    """
    _refuse_damage(folder, "pack it again")
    source, target = Store.open(folder), Store.open(address)
    paths = [file.path for file in BaselineManifest.load(source).files]
    check_address(address, paths)
    for path in (*paths, BASELINE_FILE):
        target.write_bytes(path, source.read_bytes(path))
    _refuse_damage(address, "delete what is there, and publish it again")
    return address


def check_address(address: str, paths: Collection[str] | None = None) -> None:
    """Tries whether a release can be published at an address; leaves nothing there.

    Args:
        address: of the release.
        paths: its files, which may lie there already, after an interruption; None if they are not known yet.

    Raises:
        BaselineError: it is a folder of this machine, a release lies there, or other files do.
        ObjectStoreError: nothing answers there, or nothing can be written.
    """
    if "://" not in address:
        raise BaselineError(f"{address} is not an address: expected one such as s3://bucket/mine-1.0")
    target = Store.open(address)
    target.check_access()
    if target.holds(BASELINE_FILE):
        raise BaselineError(
            f"{address} exists: a release is never overwritten; choose another name or address"
        )
    others = set(target.files()) - set(paths) - FOREIGN_FILES if paths is not None else ()
    if others:
        raise BaselineError(
            f"{address} holds {len(others)} files of something else, such as {min(others)}: choose another"
        )


def _refuse_damage(place: str | Path, remedy: str) -> None:
    problems = verify(place).problems
    if problems:
        raise BaselineError(f"{place} is not as it was packed: {problems[0]}; {remedy}")
