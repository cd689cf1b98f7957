"""The facts that a model card states of a policy: of its run, its results and its environment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from tma_ray.decoding import DamagedFileError, decode_json
from tma_ray.envs import Environment, Signal
from tma_ray.results import Results, Table
from tma_ray.runs.saved_policies import SavedPolicy, results_of
from tma_ray.runs.spec import RunSpec

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
        signal: what they mean.
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
        evaluations: in order.
        libraries: versions that the last attempt at it ran with, by name; empty if no attempt is recorded.
    """

    evaluations: tuple[Evaluation, ...]
    libraries: dict[str, str]


def history_of(saved: SavedPolicy, results: str | Path) -> History | None:
    """Returns what is known of the run of `saved`: in the root that it lies in, else in `results`.

    Returns:
        None if neither is a root that has the run.
    """
    found = results_of(saved, results)
    if found is None:
        return None
    return History(tuple(_evaluations(found, saved.spec)), _libraries(found, saved.spec.run_id))


def shown(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Returns at most `SHOWN_EVALUATIONS` of them, evenly spaced, the first and the last included."""
    count = min(len(evaluations), SHOWN_EVALUATIONS)
    return [evaluations[index] for index in np.linspace(0, len(evaluations) - 1, count).round().astype(int)]


def value_rows(environment: Environment, kind: str) -> list[ValueRow]:
    """Returns what the values of its observations or actions mean, as far as `environment` tells.

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
