"""Results, test sets and network weights of the original release, from the user's own copy."""

from tma_ray.importing.errors import DamagedSeedError, ImportRefusedError, RefusedPickleError
from tma_ray.importing.importer import ImportSummary, import_results
from tma_ray.importing.unpickling import LARGEST_MEBIBYTES, load_pickle

__all__ = [
    "LARGEST_MEBIBYTES",
    "DamagedSeedError",
    "ImportRefusedError",
    "ImportSummary",
    "RefusedPickleError",
    "import_results",
    "load_pickle",
]
