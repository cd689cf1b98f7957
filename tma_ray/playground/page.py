"""Playground page as one HTML file with style, scripts, engine, bodies and policies."""

import base64
import json
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from torch import nn

from tma_ray.embodiments import embodiment_names
from tma_ray.playground.contents import PLAYED, bodies, constants, space_record, variants, worlds
from tma_ray.results import Results, Table
from tma_ray.runs.checkpoints import SavedPolicy, results_of
from tma_ray.runs.inputs import import_plugins
from tma_ray.runs.spec import RunSpec
from tma_ray.students import policy_layers
from tma_ray.students.layers import Affine, Clamp, Standardise
from tma_ray.students.mlp.acting import RowNetwork
from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.support.component_names import base_name

SOURCES: Final = Path(__file__).parent / "page"
WASM: Final = Path(__file__).parent / "engine.wasm"  # built by docs/making/engine_building.py
SCRIPTS: Final = ("engine.js", "worlds.js", "drawing.js", "play.js")

RANDOM, ZERO = -2, -1  # indices of the untrained policies, from the end of the page's list


@dataclass(frozen=True)
class Start:
    """Initial settings of the page."""

    environment: str = "stump_tracks"  # name of the environment
    embodiment: str = "classic_bipedal"  # name of the body, including its parameters
    policies: tuple[int, ...] = (RANDOM,)  # indices of trained policies, or RANDOM or ZERO
    task: tuple[float, ...] | None = None  # task (d,); None for the middle of the space
    seed: int = 0  # seed of the page's worlds


def page_html(policies: Sequence[dict[str, Any]], start: Start, names: Sequence[str] | None = None) -> str:
    """Return the page as self-contained HTML.

    Args:
        policies: records of policies from `policy_record`.
        start: initial settings of the page.
        names: bodies, with parameters; None for every body in its own size and the first one in all sizes.
    """
    if names is None:
        names = [*embodiment_names(), start.embodiment, *(policy["embodiment"] for policy in policies)]
        names += variants(start.embodiment.partition(":")[0])
    data = {
        "wasm": np.frombuffer(WASM.read_bytes(), np.uint8),
        "constants": constants(),
        "bodies": bodies(dict.fromkeys(names)),
        **worlds(),
        "policies": list(policies),
        "start": vars(start),
    }
    text = (SOURCES / "index.html").read_text(encoding="utf-8")
    scripts = "\n".join((SOURCES / name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = (SOURCES / "style.css").read_text(encoding="utf-8")
    text = text.replace("/*STYLE*/", style).replace("/*SCRIPT*/", scripts)
    return text.replace("/*DATA*/", base64.b64encode(_packed(data)).decode())


def _packed(data: dict[str, Any]) -> bytes:
    """Return `data` compressed, as the length of a JSON string, the string, and the arrays it references.

    Arrays are stored as the first bytes of all numbers, then the second ones, which compresses better.
    """
    arrays = bytearray()

    def store(values: NDArray[Any]) -> dict[str, Any]:
        entry = [len(arrays), len(values), values.dtype.itemsize]
        arrays.extend(values.view(np.uint8).reshape(len(values), -1).T.tobytes())
        return {"array": entry}

    text = json.dumps(data, separators=(",", ":"), allow_nan=False, default=store).encode()
    return zlib.compress(len(text).to_bytes(4, "little") + text + arrays, 9)


def policy_page(saved: SavedPolicy, results: str | Path) -> str:
    """Return the page with one policy in its environment and body; errors are those of `policy_record`."""
    record = policy_record(saved, results)
    return page_html([record], Start(record["environment"], record["embodiment"], (0,)))


ACTIVATIONS: dict[type[nn.Module], Activation] = {nn.ReLU: Activation.RELU, nn.Tanh: Activation.TANH}


def policy_record(saved: SavedPolicy, results: str | Path) -> dict[str, Any]:
    """Return the data of a policy for the page.

    Args:
        saved: policy to show.
        results: folder or URI of the results root with its run, unless the policy lies in one.

    Raises:
        ValueError: if the page does not support the environment or the network.
    """
    spec = saved.spec
    if spec.environment not in PLAYED or spec.environment_options.keys() - {"embodiment"}:
        options = ", ".join(f"{name}={value}" for name, value in spec.environment_options.items())
        raise ValueError(
            f"policy {spec.run_id}: environment {spec.environment!r} with options {options or 'none'}; "
            f"the playground has {' and '.join(PLAYED)} with the option embodiment"
        )
    import_plugins(spec, "student")
    with tempfile.TemporaryDirectory() as folder:
        saved.copy(Path(folder))
        layers = saved.read(Path(folder), policy_layers)
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
    """Return the data of a network's normaliser, linear layers with one activation, and action bounds.

    Raises:
        ValueError: if there are other layers.
    """
    rest: list[Any] = [layer for layer in layers if not isinstance(layer, nn.Identity | nn.Dropout)]
    normaliser = rest.pop(0) if isinstance(rest[0], Standardise) else None
    end = max((index + 1 for index, layer in enumerate(rest) if isinstance(layer, nn.Linear)), default=0)
    linear, between, tail = rest[:end:2], rest[1:end:2], rest[end:]
    kinds = {type(layer) for layer in between} or {nn.ReLU}
    supported = (
        len(kinds) == 1
        and kinds <= ACTIVATIONS.keys()
        and {type(layer) for layer in tail} <= {nn.Tanh, Affine, Clamp}
        and all(isinstance(layer, nn.Linear) for layer in linear)
    )
    if not end or not supported:
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
    """Return a run's curriculum over time, and whether each test task was mastered at the last evaluation."""
    history: dict[str, Any] = {"curriculum": [], "tests": [], "tests_mastered": [], "mastered": None}
    if results is None:
        return history
    probes = results.table(Table.CURRICULUM, [spec.run_id], ["step", "task"]).to_pandas()
    for step, chosen in probes.groupby("step").task:
        tasks = [[round(float(value), 3) for value in task] for task in chosen]
        history["curriculum"].append({"step": int(step), "tasks": tasks})
    columns = ["step", "task_index", "episodic_return"]
    evaluations = results.table(Table.EVALUATIONS, [spec.run_id], columns).to_pandas()
    last = evaluations[evaluations.step == evaluations.step.max()]
    if len(last) and spec.test_set.dimensions == spec.task_space.names:
        mastered = last.episodic_return > spec.mastery_threshold
        history["tests"] = spec.test_set.tasks[last.task_index].tolist()
        history["tests_mastered"] = mastered.astype(int).tolist()
        history["mastered"] = round(100 * float(mastered.mean()))
    return history
