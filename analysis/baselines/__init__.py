"""Baselines: published results, and checksummed releases of campaigns."""

from analysis.baselines.catalogue import (
    About,
    Baseline,
    BaselineError,
    BaselineFile,
    BaselineKind,
    BaselineManifest,
    as_baseline,
    baselines,
    find_baseline,
    newest_release,
)
from analysis.baselines.releasing import add_to_release, median_policies, release
from analysis.baselines.verification import Verification, check_address, publish, verify

__all__ = [
    "About",
    "Baseline",
    "BaselineError",
    "BaselineFile",
    "BaselineKind",
    "BaselineManifest",
    "Verification",
    "add_to_release",
    "as_baseline",
    "baselines",
    "check_address",
    "find_baseline",
    "median_policies",
    "newest_release",
    "publish",
    "release",
    "verify",
]
