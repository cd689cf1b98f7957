"""Storage of results roots in folders, buckets and at other addresses."""

from tma_ray.results.storage.addresses import AddressStore
from tma_ray.results.storage.base import (
    ObjectStoreError,
    ResultsRootError,
    StorageError,
    Store,
    growing_pause,
    retry,
)
from tma_ray.results.storage.bucket import BucketStore
from tma_ray.results.storage.folder import DISK_FULL, FolderStore, explained_disk

__all__ = [
    "DISK_FULL",
    "AddressStore",
    "BucketStore",
    "FolderStore",
    "ObjectStoreError",
    "ResultsRootError",
    "StorageError",
    "Store",
    "explained_disk",
    "growing_pause",
    "retry",
]
