"""Trained policies as the page has them: network, curriculum, and the test tasks that they master."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from tma_ray.part_names import base_name
from tma_ray.playground.contents import PLAYED, space_record
from tma_ray.results import Results, Table
from tma_ray.runs.inputs import import_plugins
from tma_ray.runs.saved_policies import SavedPolicy, results_of
from tma_ray.runs.spec import RunSpec
from tma_ray.students import policy_layers
from tma_ray.students.layers import Affine, Clamp, Standardise
from tma_ray.students.mlp.acting import RowNetwork
from tma_ray.students.mlp.layout import Activation, Layout

ACTIVATIONS: dict[type[nn.Module], Activation] = {nn.ReLU: Activation.RELU, nn.Tanh: Activation.TANH}


def policy_record(saved: SavedPolicy, results: str | Path) -> dict[str, Any]:
    """Return everything that the page shows of a policy.

    Args:
        saved: the policy.
        results: folder or URI of a results root, which is asked for its run if it lies in none.

    Raises:
        ValueError: the page has no such environment or network; the message says which.
    """
    spec = saved.spec
    if spec.environment not in PLAYED or spec.environment_options.keys() - {"embodiment"}:
        options = ", ".join(f"{name}={value}" for name, value in spec.environment_options.items())
        raise ValueError(
            f"policy {spec.run_id}: environment {spec.environment!r} with options {options or 'none'}; "
            f"the playground has {' and '.join(PLAYED)} with the option embodiment"
        )
    import_plugins(spec, "student")
    with tempfile.TemporaryDirectory() as place:
        saved.copy(Path(place))
        layers = saved.read(Path(place), policy_layers)
    try:
        network = network_record(layers)
    except ValueError as error:
        raise ValueError(f"policy {spec.run_id}: {error}") from error
    return {
        "name": spec.run_id,
        "environment": spec.environment,
        "embodiment": spec.embodiment or "classic_bipedal",
        "challenge": spec.challenge,
        "student": base_name(spec.student),
        "label": base_name(spec.teacher),
        "seed": spec.seed,
        "threshold": spec.mastery_threshold,
        "space": space_record(spec.task_space),
        **network,
        **_history(results_of(saved, results), spec),
    }


def network_record(layers: nn.Sequential) -> dict[str, Any]:
    """Return `layers` as a record: a normaliser, linear layers with one activation, bounds of actions.

    Raises:
        ValueError: they compute something else.
    """
    rest: list[Any] = [layer for layer in layers if not isinstance(layer, nn.Identity | nn.Dropout)]
    normaliser = rest.pop(0) if isinstance(rest[0], Standardise) else None
    end = max((index + 1 for index, layer in enumerate(rest) if isinstance(layer, nn.Linear)), default=0)
    linear, between, tail = rest[:end:2], rest[1:end:2], rest[end:]
    kinds = {type(layer) for layer in between} or {nn.ReLU}
    known = (
        len(kinds) == 1
        and kinds <= ACTIVATIONS.keys()
        and {type(layer) for layer in tail} <= {nn.Tanh, Affine, Clamp}
    )
    if not end or not known or not all(isinstance(layer, nn.Linear) for layer in linear):
        names = ", ".join(type(layer).__name__ for layer in layers)
        raise ValueError(f"layers {names}: the playground has linear layers with ReLU or tangent hyperbolic")
    activation = ACTIVATIONS[kinds.pop()]
    layout = Layout((linear[0].in_features, *(layer.out_features for layer in linear)), activation)
    row = RowNetwork(layout)
    row.load(
        np.concatenate(
            [part.numpy(force=True).ravel() for layer in linear for part in (layer.weight, layer.bias)]
        )
    )
    last = {type(layer): layer for layer in tail}
    return {
        "sizes": list(layout.sizes),
        "tanh": activation is Activation.TANH,
        "weights": row.arrays[0],
        "normaliser": _buffers(normaliser) | {"clip": normaliser.clip} if normaliser else None,
        "squash": nn.Tanh in last,
        "scale": _buffers(last.get(Affine)) or None,
        "bounds": _buffers(last.get(Clamp)) or None,
    }


def _buffers(layer: Any) -> dict[str, list[float]]:
    return {} if layer is None else {name: values.tolist() for name, values in layer.named_buffers()}


def _history(results: Results | None, spec: RunSpec) -> dict[str, Any]:
    """Return the curriculum of a run over time, and its test tasks with those that it masters at last."""
    found: dict[str, Any] = {"curriculum": [], "tests": [], "tests_mastered": [], "mastered": None}
    if results is None:
        return found
    probes = results.table(Table.CURRICULUM, [spec.run_id], ["step", "task"]).to_pandas()
    for step, chosen in probes.groupby("step").task:
        tasks = [[round(float(value), 3) for value in task] for task in chosen]
        found["curriculum"].append({"step": int(step), "tasks": tasks})
    columns = ["step", "task_index", "episodic_return"]
    evaluations = results.table(Table.EVALUATIONS, [spec.run_id], columns).to_pandas()
    last = evaluations[evaluations.step == evaluations.step.max()]
    if len(last) and spec.test_set.dimensions == spec.task_space.names:
        mastered = last.episodic_return > spec.mastery_threshold
        found["tests"] = spec.test_set.tasks[last.task_index].tolist()
        found["tests_mastered"] = mastered.astype(int).tolist()
        found["mastered"] = round(100 * float(mastered.mean()))
    return found
