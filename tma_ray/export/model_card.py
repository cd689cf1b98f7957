"""The model card of an exported policy: ``README.md`` with the front matter that Hugging Face reads."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from jinja2 import Environment as Templates
from jinja2 import PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from tma_ray import __version__
from tma_ray.decoding import DamagedFileError, decode_json
from tma_ray.embodiments import Embodiment
from tma_ray.envs import Environment, Signal
from tma_ray.part_names import base_name
from tma_ray.physics import PHYSICS_VERSION, TIME_STEP
from tma_ray.results import Results, Table
from tma_ray.runs.saved_policies import SavedPolicy, results_of
from tma_ray.runs.spec import RunSpec
from tma_ray.tasks import TaskSpace

SHOWN_EVALUATIONS: Final = 11
"""How many a card shows at most: the first, the last, and some between."""

UNKNOWN: Final = "not described by the environment"


@dataclass(frozen=True)
class Evaluation:
    """The policy on its test set at one time of its training.

    Attributes:
        step: environment steps since the run began.
        tasks: number of test tasks.
        mastered_percent: share of those whose return was over the threshold.
        mean_episodic_return: over the test tasks.
    """

    step: int
    tasks: int
    mastered_percent: float
    mean_episodic_return: float


@dataclass(frozen=True)
class ValueRow:
    """Values of an observation or an action in a row.

    Attributes:
        first: index of the first.
        last: index of the last.
        signal: meaning of the values.
        low: smallest value of any.
        high: largest value of any.
    """

    first: int
    last: int
    signal: Signal
    low: float
    high: float


@dataclass(frozen=True)
class History:
    """History of a run, as its results root holds it.

    Attributes:
        evaluations: evaluations in the order of their steps.
        libraries: versions that the last attempt at it ran with, by name; empty if no attempt is recorded.
    """

    evaluations: tuple[Evaluation, ...]
    libraries: dict[str, str]


def history_of(saved: SavedPolicy, results: str | Path) -> History | None:
    """Return the history of the run of `saved`: in the root that it lies in, else in `results`.

    Returns:
        None if neither is a root that has the run.
    """
    found = results_of(saved, results)
    if found is None:
        return None
    return History(tuple(_evaluations(found, saved.spec)), _libraries(found, saved.spec.run_id))


def shown(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return at most `SHOWN_EVALUATIONS` of them, evenly spaced, the first and the last included."""
    count = min(len(evaluations), SHOWN_EVALUATIONS)
    return [evaluations[index] for index in np.linspace(0, len(evaluations) - 1, count).round().astype(int)]


def value_rows(environment: Environment, kind: str) -> list[ValueRow]:
    """Return the meaning of the values of its observations or actions, as far as `environment` tells.

    Args:
        environment: that the policy acts in.
        kind: "observation" or "action".

    Raises:
        ValueError: its signals are of more or fewer values than its space has.
    """
    space = environment.observation_space if kind == "observation" else environment.action_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"{environment} has the {kind} space {space}; expected a one-dimensional box")
    name = f"{kind}_signals"
    known = environment.has_wrapper_attr(name)
    signals: Sequence[Signal] = environment.get_wrapper_attr(name) if known else [_unknown(space)]
    if sum(signal.size for signal in signals) != space.shape[0]:
        raise ValueError(f"{name} of {environment} are not of the {space.shape[0]} values that its space has")
    return list(_rows(signals, space.low, space.high))


def _unknown(space: spaces.Box) -> Signal:
    return Signal("all", UNKNOWN, size=space.shape[0])


def _rows(
    signals: Sequence[Signal], low: NDArray[np.floating[Any]], high: NDArray[np.floating[Any]]
) -> Iterator[ValueRow]:
    first = 0
    for signal in signals:
        end = first + signal.size
        yield ValueRow(first, end - 1, signal, float(low[first:end].min()), float(high[first:end].max()))
        first = end


def _evaluations(results: Results, spec: RunSpec) -> Iterator[Evaluation]:
    rows = results.table(Table.EVALUATIONS, [spec.run_id], ["step", "episodic_return"])
    steps, returns = (rows[name].to_numpy() for name in ("step", "episodic_return"))
    for step in np.unique(steps):
        at = returns[steps == step]
        mastered = 100 * float(np.mean(at > spec.mastery_threshold))
        yield Evaluation(int(step), len(at), mastered, float(at.mean()))


def _libraries(results: Results, run_id: str) -> dict[str, str]:
    attempts = results.table(Table.ATTEMPTS, [run_id], ["attempt", "fingerprint"]).to_pylist()
    if not attempts:
        return {}
    last = max(attempts, key=lambda attempt: int(attempt["attempt"]))
    try:
        content = decode_json(last["fingerprint"], dict[str, Any], "a fingerprint")
    except DamagedFileError:
        return {}
    about_the_machine = ("cpu", "threads", "device", "system")
    return {name: str(value) for name, value in content.items() if name not in about_the_machine}


CARD_FILE: Final = "README.md"


@dataclass(frozen=True)
class ExportedFile:
    """A file next to the card.

    Attributes:
        name: name of the file.
        size: size in bytes.
        sha256: SHA-256 of its bytes.
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
        observations: number of random observations in the comparison.
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
    """Return the card of the policy of the run `spec`.

    Args:
        spec: specification of the run.
        environment: that it was trained in.
        history: its results, if they are available.
        files: files next to the card.
        onnx: facts of the ONNX file, if there is one.
        licence: licence of the policy, empty if none was given.
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
    """Return the middle of the task space the run trained in, if the environment has such tasks."""
    domain: TaskSpace = environment.get_wrapper_attr("valid_domain")
    return space.centre if space.names == domain.names else domain.centre


def _arguments(spec: RunSpec) -> Markup:
    """Return the arguments that make the environment, in Python."""
    options = [f"{name}={_python(value)}" for name, value in spec.environment_options.items()]
    return Markup(", ".join([_python(spec.environment), *options]))  # noqa: S704


def _values(row: ValueRow) -> str:
    return str(row.first) if row.first == row.last else f"{row.first} to {row.last}"


def _number(value: float) -> str:
    if math.isinf(value):
        return "none"
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def _yaml(value: object) -> Markup:
    """Return a value as YAML takes it: JSON is YAML."""
    return Markup(json.dumps(value, ensure_ascii=False))  # noqa: S704


def _python(value: object) -> Markup:
    return Markup(json.dumps(value) if isinstance(value, str) else repr(value))  # noqa: S704


def _code(value: object) -> Markup:
    """Return plain values as code within a line, also in a table."""
    return Markup(f"`{json.dumps(value)}`".replace("|", "\\|")) if value else Markup("none")  # noqa: S704


def _plain(value: object) -> object:
    """Return text without what Markdown or a table would take for its own."""
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return "".join(f"&#{ord(each)};" if each in "|`<>[]*\\\n\r" else each for each in value)
