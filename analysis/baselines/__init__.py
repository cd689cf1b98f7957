"""Results to compare with: what others published, and packed campaigns of tma_ray, with checksums."""

from analysis.baselines.catalogue import Baseline, as_baseline, baselines, find_baseline
from analysis.baselines.growing import add_to_release
from analysis.baselines.manifest import About, BaselineError, BaselineFile, BaselineKind, BaselineManifest
from analysis.baselines.publishing import check_address, publish
from analysis.baselines.releasing import release
from analysis.baselines.verification import Verification, verify

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
    "publish",
    "release",
    "verify",
]
