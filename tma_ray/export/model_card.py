"""The model card of an exported policy: ``README.md`` with the front matter that Hugging Face reads."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any, Final

from jinja2 import Environment as Templates
from jinja2 import PackageLoader, StrictUndefined
from markupsafe import Markup

from tma_ray import __version__
from tma_ray.embodiments import Embodiment
from tma_ray.envs import Environment
from tma_ray.export.model_facts import History, ValueRow, shown, value_rows
from tma_ray.part_names import base_name
from tma_ray.physics import PHYSICS_VERSION, TIME_STEP
from tma_ray.runs.spec import RunSpec
from tma_ray.tasks import TaskSpace

CARD_FILE: Final = "README.md"


@dataclass(frozen=True)
class ExportedFile:
    """A file beside the card.

    Attributes:
        name: of the file.
        size: in bytes.
        sha256: of its bytes.
    """

    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class OnnxFacts:
    """Facts that a card states of the ONNX file.

    Attributes:
        file: name of the file.
        opset: version of the operators.
        observations: how many random ones it was compared on.
        difference: largest absolute difference from the policy's actions.
    """

    file: str
    opset: int
    observations: int
    difference: float


def model_card(
    spec: RunSpec,
    environment: Environment,
    history: History | None,
    files: list[ExportedFile],
    onnx: OnnxFacts | None,
    licence: str,
) -> str:
    """Returns the card of the policy of the run `spec`.

    Args:
        spec: of the run.
        environment: that it was trained in.
        history: what its results say, if they are at hand.
        files: what lies beside the card.
        onnx: of the ONNX file, if there is one.
        licence: under which others may use the policy, empty if none was given.
    """
    evaluations = history.evaluations if history else ()
    body = environment.get_wrapper_attr("embodiment") if environment.has_wrapper_attr("embodiment") else None
    text = (
        _templates()
        .get_template("model_card.md.j2")
        .render(
            spec=spec,
            body=body if isinstance(body, Embodiment) else None,
            about=_first_sentence(environment),
            domain=environment.get_wrapper_attr("valid_domain"),
            rows={kind: value_rows(environment, kind) for kind in ("observation", "action")},
            values=_values,
            environment_arguments=_arguments(spec),
            middle=[float(value) for value in _task_in(spec.task_space, environment)],
            last=evaluations[-1] if evaluations else None,
            curve=shown(evaluations) if evaluations else [],
            evaluation_count=len(evaluations),
            libraries=history.libraries if history else {},
            files=files,
            onnx=onnx,
            licence=licence,
            version=__version__,
            physics_version=PHYSICS_VERSION,
            steps_per_second=round(1 / TIME_STEP) if isinstance(body, Embodiment) else None,
        )
    )
    return re.sub(r"\n{3,}", "\n\n", text.rstrip()) + "\n"


def _templates() -> Templates:
    templates = Templates(
        loader=PackageLoader("tma_ray.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_plain,  # Markdown, not HTML: names may be somebody else's
        autoescape=False,  # noqa: S701
    )
    templates.filters |= {
        "yaml": _yaml,
        "python": _python,
        "number": _number,
        "code": _code,
        "base": base_name,
    }
    return templates


def _first_sentence(environment: Environment) -> str:
    text = (type(environment.unwrapped).__doc__ or "").strip().partition("\n\n")[0]
    return " ".join(text.split())


def _task_in(space: TaskSpace, environment: Environment) -> Any:
    """Returns the middle of the task space the run trained in, if the environment has such tasks."""
    domain: TaskSpace = environment.get_wrapper_attr("valid_domain")
    return space.centre if space.names == domain.names else domain.centre


def _arguments(spec: RunSpec) -> Markup:
    """Returns what makes the environment, as arguments in Python."""
    options = [f"{name}={_python(value)}" for name, value in spec.environment_options.items()]
    return Markup(", ".join([_python(spec.environment), *options]))  # noqa: S704


def _values(row: ValueRow) -> str:
    return str(row.first) if row.first == row.last else f"{row.first} to {row.last}"


def _number(value: float) -> str:
    if math.isinf(value):
        return "none"
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def _yaml(value: object) -> Markup:
    """Returns a value as YAML takes it: JSON is YAML."""
    return Markup(json.dumps(value, ensure_ascii=False))  # noqa: S704


def _python(value: object) -> Markup:
    return Markup(json.dumps(value) if isinstance(value, str) else repr(value))  # noqa: S704


def _code(value: object) -> Markup:
    """Returns plain values as code within a line, also in a table."""
    return Markup(f"`{json.dumps(value)}`".replace("|", "\\|")) if value else Markup("none")  # noqa: S704


def _plain(value: object) -> object:
    """Returns text without what Markdown or a table would take for its own."""
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return "".join(f"&#{ord(each)};" if each in "|`<>[]*\\\n\r" else each for each in value)


_FILTERS = {"yaml": _yaml, "python": _python, "number": _number, "code": _code, "base": base_name}
"""Functions that the template calls."""
