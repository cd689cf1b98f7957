"""Export of a trained policy as a folder with safetensors, ONNX and a model card."""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from uuid import uuid4

import numpy as np

from tma_ray import __version__
from tma_ray.envs import Environment, box_spaces
from tma_ray.export.model_card import CARD_FILE, history_of, model_card
from tma_ray.export.onnx_file import COMPARED, ONNX_FILE, largest_difference, onnx_model, require_onnx
from tma_ray.runs.checkpoints import SavedPolicy, find_policy
from tma_ray.runs.inputs import import_plugins, new_environment, write_inputs
from tma_ray.students import Policy, load_policy, policy_layers

PLAYGROUND_FILE: Final = "playground.html"


@dataclass(frozen=True)
class Export:
    """Folder of an exported policy, its run id, and the accuracy of the ONNX file.

    Attributes:
        folder: folder of the export.
        run_id: id of the run that trained the policy.
        difference: largest absolute difference between actions of the ONNX file and of the policy; None
            without the file.
    """

    folder: Path
    run_id: str
    difference: float | None


def export(
    policy: str,
    output: str | Path,
    results: str | Path = "results",
    licence: str = "",
    onnx: bool = True,
    playground: bool = False,
) -> Export:
    """Write a policy with its ONNX file and model card to the folder `output`, atomically.

    The result can be loaded like the policy of a run.

    Args:
        policy: unambiguous prefix of a run id in `results`, or the folder of a saved policy.
        output: new or empty folder.
        results: folder or URI of a results root, which also provides the history of the run for the card.
        licence: licence of the policy, an SPDX identifier such as ``CC-BY-4.0``.
        onnx: True to write ``policy.onnx``.
        playground: True to write ``playground.html``, a page that plays the policy in a browser.

    Raises:
        ValueError: if the folder is not empty, the policy is unknown or not supported by ONNX or the
            playground, the package onnx is missing, or the licence is invalid.
    """
    output = Path(output)
    _check_output(output)
    if licence and not re.fullmatch(r"[0-9A-Za-z.+-]+", licence):
        raise ValueError(f"licence {licence!r}: expected an SPDX identifier, as in CC-BY-4.0 or MIT")
    if onnx:
        require_onnx()
    saved = find_policy(policy, results)
    import_plugins(saved.spec, "environment", "student")
    environment = new_environment(saved.spec)
    try:
        with _unfinished(output) as folder:
            saved.copy(folder)
            write_inputs(saved.spec, folder)
            for name in (CARD_FILE, ONNX_FILE, PLAYGROUND_FILE):  # present if the policy is itself an export
                (folder / name).unlink(missing_ok=True)
            saved.load(*box_spaces(environment))  # raises an error if the policy does not fit
            difference = _write_onnx(saved, environment, folder) if onnx else None
            if playground:
                from tma_ray.playground.page import policy_page  # late, since it imports the compiled engine

                (folder / PLAYGROUND_FILE).write_text(policy_page(saved, results), encoding="utf-8")
            history = history_of(saved, results)
            card = model_card(saved.spec, environment, history, folder, difference, licence)
            (folder / CARD_FILE).write_text(card)
    finally:
        environment.close()
    return Export(output, saved.spec.run_id, difference)


def _check_output(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise ValueError(f"{output} is a file; choose a new or empty folder")
    if output.is_dir() and any(output.iterdir()):
        raise ValueError(f"{output} is not empty; choose a new or empty folder")
    existing = next(folder for folder in output.absolute().parents if folder.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise ValueError(f"{output}: {existing} cannot be written to; choose another folder")


@contextmanager
def _unfinished(output: Path) -> Iterator[Path]:
    """Context manager that yields a temporary folder, renamed to `output` unless an error occurs."""
    output = output.resolve()
    folder = output.with_name(f".{output.name}-{uuid4().hex}")
    folder.mkdir(parents=True)
    try:
        yield folder
        folder.replace(output)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_onnx(saved: SavedPolicy, environment: Environment, folder: Path) -> float:
    """Write the ONNX file, and return the largest difference between its actions and the policy's."""
    observations, actions = box_spaces(environment)
    policy: Policy = saved.read(folder, load_policy)
    layers, spec = saved.read(folder, policy_layers), saved.spec
    properties = {
        "run_id": spec.run_id,
        "environment": spec.environment,
        "embodiment": spec.embodiment,
        "student": spec.student,
        "teacher": spec.teacher,
        "seed": str(spec.seed),
        "steps": str(spec.schedule.steps),
        "physics_version": str(spec.physics_version),
        "tma_ray_version": __version__,
    }
    model = onnx_model(layers, (observations.shape[0], actions.shape[0]), properties)
    # random observations: uniform where bounded, else normal
    rng = np.random.default_rng(0)
    bounded = np.isfinite(observations.low) & np.isfinite(observations.high)
    low, high = (np.where(bounded, bound, 0.0) for bound in (observations.low, observations.high))
    shape = (COMPARED, *observations.shape)
    examples = np.where(bounded, rng.uniform(low, high, shape), rng.normal(0.0, 2.0, shape))
    widths = actions.high - actions.low
    difference = largest_difference(model, policy, examples.astype(np.float32), widths)
    (folder / ONNX_FILE).write_bytes(model.SerializeToString(deterministic=True))
    return difference
