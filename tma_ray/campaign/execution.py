"""Execution of campaigns: checks of every node, connection to Ray, scheduling."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.base import (
    BEGUN,
    GRACE_SECONDS,
    capacity,
    exit_on_head_loss,
    living_nodes,
    offers,
    use_shipped,
    working_nodes,
)
from tma_ray.campaign.cluster.heads import OwnProcesses, connect
from tma_ray.campaign.executors.cohorts import Cohorts, check_room, kinds_of
from tma_ray.campaign.executors.ray_executor import RayExecutor
from tma_ray.campaign.failures import stop_signals
from tma_ray.campaign.plan import Plan, lease_holder
from tma_ray.campaign.progress import ProgressView, PublishedProgress, Snapshot, View
from tma_ray.campaign.scheduler import Scheduler
from tma_ray.campaign.settings import Resources, Settings
from tma_ray.envs import make_environment
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
    arguments,
    contents,
    import_plugins,
    importing_plugins,
    plugin_sources,
    provide,
)
from tma_ray.runs.placement import check_available
from tma_ray.runs.spec import RunSpec


def execute_plan(
    plan: Plan,
    results: str | Path,
    settings: Settings | None = None,
    address: str | None = None,
    view: View | None = None,
) -> Snapshot:
    """Execute the runs of `plan` that a results root lacks; return the numbers of runs by outcome.

    Bad input is refused before the first step. Without an address, a Ray is started on this machine.

    Raises:
        ValueError: an unknown name, missing knowledge, impossible resources.
        ResultsRootError: the root belongs to something else or to another version.
        RootInUseError: another campaign is running on it.
        ConnectionError: no cluster answers at `address`, or an object store refuses us or a node.
        OutageError: the storage of the results was gone for too long; the same call continues.
        HeadLostError: Ray was gone for too long; the same call continues.
        RuntimeError: called by a module that is imported for its plug-in.
    """
    settings = settings or Settings()
    if importing_plugins():
        raise RuntimeError(
            f"campaign {plan.name!r} was started by a module that was imported for its plug-in: "
            f"put the call below 'if __name__ == \"__main__\":'"
        )
    store = Store.open(results)
    check_usable(store)
    kinds = kinds_of(plan.runs) if settings.width else {}
    if address is None:
        check_available(settings.device)
    with exit_on_head_loss(OwnProcesses(), plan.name):
        connection = connect(address, plugin_sources(plan.runs))
    with closing(connection.head) as head:
        with exit_on_head_loss(head, plan.name):
            if settings.width and not settings.autoscaling:
                check_room(settings, plan.runs, kinds)
            elif not settings.autoscaling:
                check_feasible(settings.resources)
            if not connection.is_own:
                check_installation()
            check_storage_access(store)
            warm_nodes(plan.runs, connection.shipped)
        committer = Committer(store)
        with Lease(store, lease_holder(plan.name)) as lease, ExitStack() as stack:
            if plan.cell_rows:
                committer.write_cells(plan.name, plan.cell_rows)
            committer.sweep()
            progress = PublishedProgress(view or ProgressView(), HeartbeatWriter(store, lease.holder))
            cohorts = Cohorts(settings, head, plan.runs, kinds) if settings.width else None
            executor = RayExecutor(store, settings, head, cohorts)
            scheduler = Scheduler(committer, executor, settings, progress, lease.keep)

            def conclude() -> None:
                scheduler.abandon()
                lease.release()

            stop = stack.enter_context(stop_signals())
            if connection.is_own:  # a cluster is waited for
                watch = exit_on_head_loss(head, plan.name, BEGUN, grace=GRACE_SECONDS, conclude=conclude)
                stack.enter_context(watch)
            return scheduler.execute(plan.runs, lambda: stop.is_set() or lease.asked_to_stop())


def check_installation() -> None:
    """Refuse a cluster some of whose nodes have another tma_ray, or none.

    Ray's processes run in the environment in which Ray was started there, also on the driver's own node.

    Raises:
        ConnectionError: a node has other versions; the message names it and them.
    """

    def installed() -> str:  # sent whole: one of this module could only be found where tma_ray is
        from importlib.metadata import version

        import tma_ray  # noqa: F401

        return version("tma_ray")

    here = version("tma_ray")
    task = ray.remote(num_cpus=0, max_retries=0)(installed)
    asked = {_ask(node["NodeID"], task): node["NodeManagerAddress"] for node in working_nodes()}
    for answer, address in asked.items():
        try:
            found = ray.get(answer)
        except RayError as error:
            found = f"none that can be imported ({_cause(error)})"
        if found != here:
            raise ConnectionError(
                f"the Ray node {address} has another tma_ray than this process: {found}, not {here}. "
                f"Install tma_ray {here} in the environment in which 'ray start' is called on that node, and "
                f"start Ray there again"
            )


def _ask(node: str, task: Any, *arguments: Any) -> Any:
    """Return the future of a task on a node, by Ray's id, or on another node if that one is gone."""
    there = NodeAffinitySchedulingStrategy(node, soft=True)
    return task.options(scheduling_strategy=there).remote(*arguments)


def _cause(error: RayError) -> Exception:
    return error.cause if isinstance(error, RayTaskError) else error


def check_feasible(resources: Resources) -> None:
    """Refuse runs that no node can hold: Ray would let them wait forever.

    Raises:
        ValueError: a run needs more than any node has.
    """
    nodes = living_nodes()
    if capacity(resources, nodes):
        return
    have = offers([node["Resources"] for node in nodes])
    raise ValueError(
        f"no node can hold a run of {resources.cpus:g} CPUs, {resources.gpus:g} GPUs and "
        f"{resources.memory_gib:g} GiB: the nodes have {have}; ask for less, add larger nodes, or give "
        f"'--autoscaling' if the cluster adds them by itself"
    )


def check_storage_access(store: Store) -> None:
    """Refuse a root that some node cannot use: another machine's folder, a bucket without credentials.

    Raises:
        ResultsRootError: a node does not see the folder.
        ObjectStoreError: a node cannot use the bucket; each has credentials of its own.
    """
    here = ray.get_runtime_context().get_node_id()
    if store.is_object_store:
        _ask_nodes(store, working_nodes(), None)
    elif others := [node for node in working_nodes() if node["NodeID"] != here]:
        probe = store.temporary()
        store.write_bytes(probe, b"seen")
        try:
            _ask_nodes(store, others, probe)
        finally:
            store.delete(probe)


def _ask_nodes(store: Store, nodes: Sequence[dict[str, Any]], probe: str | None) -> None:
    task = ray.remote(num_cpus=0)(can_access)
    asked = {_ask(node["NodeID"], task, store, probe): node["NodeManagerAddress"] for node in nodes}
    for answer, address in asked.items():
        try:
            if not ray.get(answer):
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
    """Return True if this node sees the file `probe` of `store`, or may use the bucket if that is None."""
    if probe is not None:
        return store.exists(probe)
    store.check_access()
    return True


_tried: set[tuple[str, object]] = set()
"""Pairs of a node and a recipe of an environment that this process has tried there."""


def warm_nodes(specs: Sequence[RunSpec], shipped: bool = True) -> None:
    """Make every environment of `specs` once on every node, and import every plug-in there.

    What is compiled on the way stays in the nodes' caches, so that actors do not all compile at once. On
    its own node the driver itself tries what needs no plug-in. Nodes that join later compile when they
    start their first run. With `shipped` this connection to Ray brought the plug-ins to the workers.

    Raises:
        ValueError: a node cannot import a plug-in, or has another version of it.
    """
    here = ray.get_runtime_context().get_node_id()
    recipes = {
        (s.environment, *s.environment_options.items(), *s.plugins.items(), *s.inputs.items()): s
        for s in specs
    }
    due = {
        (node["NodeID"], recipe): spec
        for node in working_nodes()
        for recipe, spec in recipes.items()
        if spec.plugins or node["NodeID"] != here
    }
    for recipe, spec in recipes.items():
        if not spec.plugins and (here, recipe) not in _tried:
            _try(spec)
            _tried.add((here, recipe))
    tasks = defaultdict(list)
    for (node, recipe), spec in due.items():
        if (node, recipe) not in _tried:
            tasks[node].append(spec.to_dict())
    # One call a process: it would keep the plug-ins that it has imported. One process a node: starting
    # takes a process longer than trying.
    task, files = ray.remote(max_calls=1, num_cpus=0)(_try_all), contents(specs)
    try:
        ray.get([_ask(node, task, planned, files) for node, planned in tasks.items()])
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
    environment = make_environment(spec.environment, **arguments(spec, "environment"))
    environment.reset(seed=0, options={"task": spec.task_space.low})
    environment.close()
