"""Results as Parquet tables: written by runs, published by one committer, read by anyone."""

from tma_ray.decoding import DamagedFileError, DamagedFileWarning
from tma_ray.results.arrow_alone import leave_pandas_out
from tma_ray.results.committer import Committer, StaleAttemptError, accepted_manifest
from tma_ray.results.engines import BOX2D, BOX2D_TEST_SET, CHIPMUNK, NO_PHYSICS_VERSION, SIMULATED
from tma_ray.results.holding.heartbeat import Heartbeat, HeartbeatWriter, LearnerProgress, RunProgress
from tma_ray.results.holding.lease import Lease, NotRunningError, RootInUseError, ask_to_stop, holder_of
from tma_ray.results.inputs import (
    input_path,
    keep_input,
    keep_plugin,
    read_input,
    read_plugin,
)
from tma_ray.results.inspection import Damage, Inspector, damage_reason
from tma_ray.results.layout import (
    CHECKPOINTS,
    INPUTS,
    LOGS,
    MANIFESTS,
    POLICIES,
    TABLES,
    check_id,
    check_path,
    check_root,
    check_usable,
    create_root,
    log_path,
    policy_folder,
    staged_policy,
)
from tma_ray.results.manifest import Manifest, PartFile, read_checked
from tma_ray.results.merging.compaction import Compaction, compact
from tma_ray.results.merging.copying import Copy, copy_merged
from tma_ray.results.merging.packing import LEAN, WHOLE, Contents
from tma_ray.results.merging.shards import Shard, add_shard, start_from
from tma_ray.results.progressing import write_progress
from tma_ray.results.published import PUBLISHED_FILE, PUBLISHED_SCHEMA, read_published, write_published
from tma_ray.results.reader import Results
from tma_ray.results.records import (
    AttemptOutcome,
    AttemptRecord,
    RunRecord,
    RunStatus,
    SpecFacts,
    spec_digest,
)
from tma_ray.results.rows import teacher_log_row
from tma_ray.results.schema import DATA_TABLES, SCHEMA_VERSION, SCHEMAS, Table
from tma_ray.results.storage.errors import DISK_FULL, ResultsRootError, StorageError, explained_disk, retry
from tma_ray.results.storage.object_store import ObjectStoreError
from tma_ray.results.storage.recorded_store import RecordedStore
from tma_ray.results.storage.store import Store
from tma_ray.results.verification import RootVerification, verify_root
from tma_ray.results.writer import RunWriter

__all__ = [
    "BOX2D",
    "BOX2D_TEST_SET",
    "CHECKPOINTS",
    "CHIPMUNK",
    "DATA_TABLES",
    "DISK_FULL",
    "INPUTS",
    "LEAN",
    "LOGS",
    "MANIFESTS",
    "NO_PHYSICS_VERSION",
    "POLICIES",
    "PUBLISHED_FILE",
    "PUBLISHED_SCHEMA",
    "SCHEMAS",
    "SCHEMA_VERSION",
    "SIMULATED",
    "TABLES",
    "WHOLE",
    "AttemptOutcome",
    "AttemptRecord",
    "Committer",
    "Compaction",
    "Contents",
    "Copy",
    "Damage",
    "DamagedFileError",
    "DamagedFileWarning",
    "Heartbeat",
    "HeartbeatWriter",
    "Inspector",
    "LearnerProgress",
    "Lease",
    "Manifest",
    "NotRunningError",
    "ObjectStoreError",
    "PartFile",
    "RecordedStore",
    "Results",
    "ResultsRootError",
    "RootInUseError",
    "RootVerification",
    "RunProgress",
    "RunRecord",
    "RunStatus",
    "RunWriter",
    "Shard",
    "SpecFacts",
    "StaleAttemptError",
    "StorageError",
    "Store",
    "Table",
    "accepted_manifest",
    "add_shard",
    "ask_to_stop",
    "check_id",
    "check_path",
    "check_root",
    "check_usable",
    "compact",
    "copy_merged",
    "create_root",
    "damage_reason",
    "explained_disk",
    "holder_of",
    "input_path",
    "keep_input",
    "keep_plugin",
    "leave_pandas_out",
    "log_path",
    "policy_folder",
    "read_checked",
    "read_input",
    "read_plugin",
    "read_published",
    "retry",
    "spec_digest",
    "staged_policy",
    "start_from",
    "teacher_log_row",
    "verify_root",
    "write_progress",
    "write_published",
]
