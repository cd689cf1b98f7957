"""Warm-up of every node: each environment and plug-in is tried there before the first run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.connection import working_nodes
from tma_ray.campaign.preflight.shipping import use_shipped
from tma_ray.envs import make_environment
from tma_ray.runs.inputs import arguments, contents, provide
from tma_ray.runs.plugins import REGISTRIES, import_plugins
from tma_ray.runs.spec import RunSpec

_tried: set[tuple[str, object]] = set()
"""Nodes and what this process has tried there."""


def warm_nodes(specs: Sequence[RunSpec], shipped: bool = True) -> None:
    """Makes every environment of `specs` once on every node, and imports every plug-in there.

    What is compiled on the way stays in the nodes' caches, so that actors do not all compile at once. On
    its own node the driver itself tries what needs no plug-in. Nodes that join later compile when they
    start their first run.

    Args:
        specs: the runs.
        shipped: whether this connection to Ray brought the plug-ins to the workers.

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
    _try_on(tasks, contents(specs), shipped)
    _tried.update(due)


def _try_on(tasks: Mapping[str, Sequence[dict[str, Any]]], files: Mapping[str, bytes], shipped: bool) -> None:
    """Tries the specs of each node there, with the files that they read."""
    # One call a process: it would keep the plug-ins that it has imported. One process a node: starting
    # takes a process longer than trying.
    task: Any = ray.remote(max_calls=1, num_cpus=0)(_try_all)
    started = [
        task.options(scheduling_strategy=NodeAffinitySchedulingStrategy(node, soft=True)).remote(
            planned, files
        )
        for node, planned in tasks.items()
    ]
    try:
        ray.get(started)
    except RayError as error:
        cause = error.cause if isinstance(error, RayTaskError) else error
        hint = (
            "" if shipped else "; Ray was connected before, so no plug-in was shipped: ray.shutdown() first"
        )
        raise ValueError(
            f"a plug-in or environment does not work on the workers: {type(cause).__name__}: {cause}{hint}"
        ) from error


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
