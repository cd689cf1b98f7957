"""Checks before the first run: resources, installation, storage and plug-ins of every node."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.base import capacity, living_nodes, offers, working_nodes
from tma_ray.campaign.settings import Resources
from tma_ray.envs import make_environment
from tma_ray.plugin_source import PluginSource
from tma_ray.results import ObjectStoreError, ResultsRootError, Store
from tma_ray.runs.inputs import REGISTRIES, arguments, contents, import_plugins, provide
from tma_ray.runs.spec import RunSpec


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
    """Return the answer to come of a task on a node, by Ray's id, or on another if that node is gone."""
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


FOLDER = "tma_ray_plugins"
"""Folder of the shipped files, which a worker finds as a package of that name."""

MOST_BYTES = 20 * 2**20
"""Largest size of shipped files, in bytes: larger data belongs on the nodes or in storage."""


@contextmanager
def runtime_environment(sources: Sequence[PluginSource]) -> Iterator[dict[str, Any] | None]:
    """Context manager of a Ray runtime environment that brings plug-ins to every worker of a job.

    The files are copied first: what is edited while a campaign runs does not reach its workers.
    Installed packages are not shipped; every node needs them by itself.

    Returns:
        The `runtime_env` of `ray.init`, None if there is nothing to ship.

    Raises:
        ValueError: the files are larger than `MOST_BYTES`.
    """
    files = {path: code for each in sources if not each.installed for path, code in each.files.items()}
    total = sum(map(len, files.values()))
    if total > MOST_BYTES:
        largest = max(files, key=lambda path: len(files[path]))
        raise ValueError(
            f"the plug-ins' files are {total / 2**20:.0f} MiB ({largest}: {len(files[largest]) / 2**20:.0f} "
            f"MiB), more than the {MOST_BYTES / 2**20:.0f} MiB that are shipped to workers; install them on "
            f"the nodes, or read large data from a path that all nodes have"
        )
    if not files:
        yield None
        return
    with tempfile.TemporaryDirectory() as place:
        for path, code in files.items():
            file = Path(place, FOLDER, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(code)
        yield {"py_modules": [str(Path(place, FOLDER))]}


def use_shipped() -> None:
    """Put the shipped files first on the search path of this worker."""
    try:
        shipped = importlib.import_module(FOLDER)
    except ModuleNotFoundError:  # nothing was shipped: all is installed, or Ray was connected before
        return
    root = next(iter(shipped.__path__))
    if root not in sys.path:
        sys.path.insert(0, root)


_tried: set[tuple[str, object]] = set()
"""Pairs of a node and a recipe of an environment that this process has tried there."""


def warm_nodes(specs: Sequence[RunSpec], shipped: bool = True) -> None:
    """Make every environment of `specs` once on every node, and import every plug-in there.

    What is compiled on the way stays in the nodes' caches, so that actors do not all compile at once. On
    its own node the driver itself tries what needs no plug-in. Nodes that join later compile when they
    start their first run.

    Args:
        specs: the runs.
        shipped: True if this connection to Ray brought the plug-ins to the workers.

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
