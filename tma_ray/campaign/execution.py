"""Execution of campaigns: connection to Ray, checks of every node, scheduling."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.connection import LocalRayWatch, connect, use_shipped
from tma_ray.campaign.cluster.nodes import capacity, resource_text, working_nodes
from tma_ray.campaign.cluster.protocols import BEGUN, GRACE_SECONDS, exit_on_head_loss
from tma_ray.campaign.cluster.ray_private import living_nodes
from tma_ray.campaign.executors.cohorts import Cohorts, check_room, stack_keys
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.failures import stop_signals
from tma_ray.campaign.plan import Plan, lease_holder
from tma_ray.campaign.progress import ProgressDisplay, ProgressView, PublishedProgress, Snapshot
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import ExecutionConfig, Resources
from tma_ray.results import (
    Committer,
    HeartbeatWriter,
    Lease,
    ObjectStoreError,
    ResultsRootError,
    Store,
    check_usable,
)
from tma_ray.runs.inputs import (
    REGISTRIES,
    RunInputs,
    import_plugins,
    importing_plugins,
    new_environment,
    provide,
)
from tma_ray.runs.placement import check_available
from tma_ray.runs.spec import RunSpec


def execute_plan(
    plan: Plan,
    results: str | Path,
    settings: ExecutionConfig | None = None,
    address: str | None = None,
    view: ProgressDisplay | None = None,
) -> Snapshot:
    """Execute the runs of `plan` missing from a results root, and return the campaign's final progress.

    Invalid input is refused before the first step. Without an address, Ray is started on this machine.

    Raises:
        ValueError: if a name is unknown, knowledge is missing, or no node has the resources.
        ResultsRootError: if the root belongs to something else or to another version.
        RootInUseError: if another campaign is running on it.
        ConnectionError: if no cluster answers at `address`, or an object store refuses access.
        OutageError: if the results' storage is unavailable for too long; the same call continues.
        HeadLostError: if Ray is unavailable for too long; the same call continues.
        RuntimeError: if a module that is being imported for its plug-in calls it.
    """
    settings = settings or ExecutionConfig()
    if importing_plugins():
        raise RuntimeError(
            f"campaign {plan.name!r} was started by a module that was imported for its plug-in: "
            f"put the call below 'if __name__ == \"__main__\":'"
        )
    store = Store.open(results)
    check_usable(store)
    inputs = RunInputs.of(plan.runs)
    keys = stack_keys(plan.runs) if settings.width else {}
    if address is None:
        check_available(settings.device)
    with exit_on_head_loss(LocalRayWatch(), plan.name):
        connection = connect(address, inputs.sources)
    with closing(connection.head) as head:
        with exit_on_head_loss(head, plan.name):
            if settings.width and not settings.autoscaling:
                check_room(settings, plan.runs, keys)
            elif not settings.autoscaling:
                check_feasible(settings.resources)
            if not connection.is_own:
                check_installation()
            check_storage_access(store)
            warm_nodes(plan.runs, inputs.files, connection.shipped)
        committer = Committer(store)
        with Lease(store, lease_holder(plan.name)) as lease, ExitStack() as stack:
            if plan.cell_rows:
                committer.write_cells(plan.name, plan.cell_rows)
            committer.sweep()
            inputs.keep(store)
            progress = PublishedProgress(view or ProgressView(), HeartbeatWriter(store, lease.holder))
            cohorts = Cohorts(settings, head, plan.runs, keys) if settings.width else None
            executor = RayExecutor(store, settings, head, cohorts)
            scheduler = Scheduler(committer, executor, settings, progress, lease.keep)

            def conclude() -> None:
                scheduler.record_loss()
                lease.release()

            stop = stack.enter_context(stop_signals())
            if connection.is_own:  # only then: the head of an existing cluster may come back
                watch = exit_on_head_loss(head, plan.name, BEGUN, grace=GRACE_SECONDS, conclude=conclude)
                stack.enter_context(watch)
            return scheduler.execute(plan.runs, lambda: stop.is_set() or lease.asked_to_stop())


def check_installation() -> None:
    """Check that all nodes have this version of tma_ray.

    Ray's processes run in the environment in which Ray was started, even on the driver's node.

    Raises:
        ConnectionError: if a node has another version or none.
    """

    def installed() -> str:  # nested so that Ray pickles it by value
        from importlib.metadata import version

        import tma_ray  # noqa: F401

        return version("tma_ray")

    expected = version("tma_ray")
    task = ray.remote(num_cpus=0, max_retries=0)(installed)
    futures = {_submit(node["NodeID"], task): node["NodeManagerAddress"] for node in working_nodes()}
    for future, address in futures.items():
        try:
            actual = ray.get(future)
        except RayError as error:
            actual = f"none that can be imported ({_cause(error)})"
        if actual != expected:
            raise ConnectionError(
                f"the Ray node {address} has another tma_ray than this process: {actual}, not {expected}. "
                f"Install tma_ray {expected} in the environment in which 'ray start' is called on that node, "
                f"and start Ray there again"
            )


def _submit(node: str, task: Any, *arguments: Any) -> Any:
    """Submit a task to the node with Ray id `node`, or to another if that node is gone; return the future."""
    strategy = NodeAffinitySchedulingStrategy(node, soft=True)
    return task.options(scheduling_strategy=strategy).remote(*arguments)


def _cause(error: RayError) -> Exception:
    return error.cause if isinstance(error, RayTaskError) else error


def check_feasible(resources: Resources) -> None:
    """Check that some node has the resources of a run; otherwise Ray would queue it forever.

    Raises:
        ValueError: if a run needs more than any node has.
    """
    nodes = living_nodes()
    if capacity(resources, nodes):
        return
    available = resource_text([node["Resources"] for node in nodes])
    raise ValueError(
        f"no node can hold a run of {resources.cpus:g} CPUs, {resources.gpus:g} GPUs and "
        f"{resources.memory_gib:g} GiB: the nodes have {available}; ask for less, add larger nodes, or give "
        f"'--autoscaling' if the cluster adds them by itself"
    )


def check_storage_access(store: Store) -> None:
    """Check that every node can use the results root.

    Raises:
        ResultsRootError: if a node does not see the folder.
        ObjectStoreError: if a node cannot use the bucket with its own credentials.
    """
    this_node = ray.get_runtime_context().get_node_id()
    if store.is_object_store:
        _check_access(store, working_nodes(), None)
    elif others := [node for node in working_nodes() if node["NodeID"] != this_node]:
        probe = store.temporary()
        store.write_bytes(probe, b"seen")
        try:
            _check_access(store, others, probe)
        finally:
            store.delete(probe)


def _check_access(store: Store, nodes: Sequence[dict[str, Any]], probe: str | None) -> None:
    task = ray.remote(num_cpus=0)(can_access)
    futures = {_submit(node["NodeID"], task, store, probe): node["NodeManagerAddress"] for node in nodes}
    for future, address in futures.items():
        try:
            if not ray.get(future):
                raise ResultsRootError(
                    f"the Ray node {address} does not see this machine's {store}: choose a folder that all "
                    f"nodes mount, or s3:// or gs://"
                )
        except RayError as error:
            raise ObjectStoreError(
                f"the Ray node {address} cannot use the root: {_cause(error)}; every node takes its "
                f"credentials from its role or from the environment in which Ray was started there"
            ) from error


def can_access(store: Store, probe: str | None) -> bool:
    """Return True if this node can access `store`: the file `probe` in it or, if None, its bucket."""
    if probe is not None:
        return store.exists(probe)
    store.check_access()
    return True


_tried: set[tuple[str, object]] = set()
"""Pairs of node id and environment that this process has tried."""


def warm_nodes(specs: Sequence[RunSpec], files: Mapping[str, bytes], shipped: bool = True) -> None:
    """Construct the environments and import the plug-ins of `specs` once on every node.

    This fills the nodes' compilation caches, so that actors do not all compile at once. The driver tries
    environments without plug-ins itself. Nodes that join later compile in their first run.

    Args:
        specs: planned runs.
        files: contents of their input files, by SHA-256.
        shipped: True if this connection shipped the plug-ins.

    Raises:
        ValueError: if a node cannot import a plug-in, or has another version of it.
    """
    this_node = ray.get_runtime_context().get_node_id()
    recipes = {
        (s.environment, *s.environment_options.items(), *s.plugins.items(), *s.inputs.items()): s
        for s in specs
    }
    due = {
        (node["NodeID"], recipe): spec
        for node in working_nodes()
        for recipe, spec in recipes.items()
        if spec.plugins or node["NodeID"] != this_node
    }
    for recipe, spec in recipes.items():
        if not spec.plugins and (this_node, recipe) not in _tried:
            _try(spec)
            _tried.add((this_node, recipe))
    tasks = defaultdict(list)
    for (node, recipe), spec in due.items():
        if (node, recipe) not in _tried:
            tasks[node].append(spec.to_dict())
    # One process per node, since processes start slowly, and a fresh one, since imports persist.
    task = ray.remote(max_calls=1, num_cpus=0)(_try_all)
    try:
        ray.get([_submit(node, task, planned, files) for node, planned in tasks.items()])
    except RayError as error:
        cause = _cause(error)
        hint = (
            "" if shipped else "; Ray was connected before, so no plug-in was shipped: ray.shutdown() first"
        )
        raise ValueError(
            f"a plug-in or environment does not work on the workers: {type(cause).__name__}: {cause}{hint}"
        ) from error
    _tried.update(due)


def _try_all(specs: Sequence[dict[str, Any]], files: Mapping[str, bytes]) -> None:
    use_shipped()
    provide(files)
    for spec in specs:
        _try(RunSpec.from_dict(spec))


def _try(spec: RunSpec) -> None:
    import_plugins(spec, *REGISTRIES)
    environment = new_environment(spec)
    environment.reset(seed=0, options={"task": spec.task_space.low})
    environment.close()
