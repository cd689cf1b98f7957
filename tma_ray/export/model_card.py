"""Model card of an exported policy: ``README.md`` with the front matter of Hugging Face."""

import hashlib
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from jinja2 import Environment as Templates
from jinja2 import PackageLoader, StrictUndefined
from markupsafe import Markup

from tma_ray import __version__
from tma_ray.embodiments import Embodiment
from tma_ray.envs import Environment, Signal
from tma_ray.export.onnx_file import COMPARED, ONNX_FILE, OPSET
from tma_ray.physics import PHYSICS_VERSION, TIME_STEP
from tma_ray.results import Table
from tma_ray.runs.checkpoints import SavedPolicy, results_of
from tma_ray.runs.spec import RunSpec
from tma_ray.support.component_names import base_name
from tma_ray.support.decoding import DamagedFileError, decode_json
from tma_ray.tasks import TaskSpace

SHOWN_EVALUATIONS: Final = 11  # largest number of evaluations on a card
CARD_FILE: Final = "README.md"


def history_of(saved: SavedPolicy, results: str | Path) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return the evaluations of a policy's run, by step, and the library versions of its last attempt.

    They come from its own results root, else from `results`, and are empty if neither has the run.
    """
    root, spec = results_of(saved, results), saved.spec
    if root is None:
        return [], {}
    rows = root.table(Table.EVALUATIONS, [spec.run_id], ["step", "episodic_return"])
    steps, all_returns = (rows[name].to_numpy() for name in ("step", "episodic_return"))
    evaluations = []
    for step in np.unique(steps):
        returns = all_returns[steps == step]
        share, mean = 100 * float(np.mean(returns > spec.mastery_threshold)), float(returns.mean())
        evaluations.append(
            {"step": int(step), "tasks": len(returns), "mastered_percent": share, "mean_return": mean}
        )
    attempts = root.table(Table.ATTEMPTS, [spec.run_id], ["attempt", "fingerprint"]).to_pylist()
    last = max(attempts, key=lambda attempt: int(attempt["attempt"]), default={"fingerprint": "{}"})
    try:
        content = decode_json(last["fingerprint"], dict[str, Any], "a fingerprint")
    except DamagedFileError:
        content = {}
    machine = ("cpu", "vector_extensions", "threads", "device", "system")
    return evaluations, {name: str(value) for name, value in content.items() if name not in machine}


def value_rows(environment: Environment, kind: str) -> list[dict[str, Any]]:
    """Return the signals of an observation or action (`kind`) as rows with indices and bounds.

    Raises:
        ValueError: if the signals and the space have different numbers of values.
    """
    space = environment.observation_space if kind == "observation" else environment.action_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"{environment} has the {kind} space {space}; expected a one-dimensional box")
    name, count = f"{kind}_signals", space.shape[0]
    signals: Sequence[Signal] = (Signal("all", "not described by the environment", size=count),)
    if environment.has_wrapper_attr(name):
        signals = environment.get_wrapper_attr(name)
    if sum(signal.size for signal in signals) != count:
        raise ValueError(f"{name} of {environment} are not of the {count} values that its space has")
    rows, first = [], 0
    for signal in signals:
        end = first + signal.size
        low, high = float(space.low[first:end].min()), float(space.high[first:end].max())
        rows.append({"first": first, "last": end - 1, "signal": signal, "low": low, "high": high})
        first = end
    return rows


def model_card(
    spec: RunSpec,
    environment: Environment,
    history: tuple[list[dict[str, Any]], dict[str, str]],
    folder: Path,
    difference: float | None,
    licence: str,
) -> str:
    """Return the card of a policy, with its `history` (see `history_of`) and the files in `folder`."""
    evaluations, libraries = history
    body = environment.get_wrapper_attr("embodiment") if environment.has_wrapper_attr("embodiment") else None
    domain: TaskSpace = environment.get_wrapper_attr("valid_domain")
    space = spec.task_space if spec.task_space.names == domain.names else domain
    about = (type(environment.unwrapped).__doc__ or "").strip().partition("\n\n")[0]
    options = [f"{name}={_python(value)}" for name, value in spec.environment_options.items()]
    count = min(len(evaluations), SHOWN_EVALUATIONS)
    shown = np.linspace(0, len(evaluations) - 1, count).round().astype(int)
    templates = Templates(
        loader=PackageLoader("tma_ray.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_plain,  # escapes for Markdown, not for HTML
        autoescape=False,  # noqa: S701
    )
    filters = {"yaml": _yaml, "python": _python, "number": _number, "code": _code, "base": base_name}
    templates.filters |= filters
    text = templates.get_template("model_card.md.j2").render(
        spec=spec,
        body=body if isinstance(body, Embodiment) else None,
        about=" ".join(about.split()),
        rows={kind: value_rows(environment, kind) for kind in ("observation", "action")},
        environment_arguments=Markup(", ".join([_python(spec.environment), *options])),  # noqa: S704
        middle=[float(value) for value in space.centre],
        last=evaluations[-1] if evaluations else None,
        curve=[evaluations[index] for index in shown],
        evaluation_count=len(evaluations),
        libraries=libraries,
        files=[
            (path.name, path.stat().st_size, hashlib.sha256(path.read_bytes()).hexdigest())
            for path in sorted(folder.iterdir())
        ],
        onnx=difference is not None,
        difference=difference,
        onnx_file=ONNX_FILE,
        opset=OPSET,
        compared=COMPARED,
        licence=licence,
        version=__version__,
        physics_version=PHYSICS_VERSION,
        steps_per_second=round(1 / TIME_STEP) if isinstance(body, Embodiment) else None,
    )
    return re.sub(r"\n{3,}", "\n\n", text.rstrip()) + "\n"


def _number(value: float) -> str:
    if math.isinf(value):
        return "none"
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def _yaml(value: object) -> Markup:
    """Return a value as JSON, which is valid YAML."""
    return Markup(json.dumps(value, ensure_ascii=False))  # noqa: S704


def _python(value: object) -> Markup:
    return Markup(json.dumps(value) if isinstance(value, str) else repr(value))  # noqa: S704


def _code(value: object) -> Markup:
    """Return a value as inline code, escaped for use in tables."""
    return Markup(f"`{json.dumps(value)}`".replace("|", "\\|")) if value else Markup("none")  # noqa: S704


def _plain(value: object) -> object:
    """Escape Markdown's special characters in a string."""
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return "".join(
        f"&#{ord(character)};" if character in "|`<>[]*\\\n\r" else character for character in value
    )
