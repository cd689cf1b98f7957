"""Names under which gymnasium and the command line find the environments."""

import math
from collections.abc import Callable
from numbers import Real
from typing import Any

import gymnasium

from tma_ray.components.settings import coerce, parameters_of, parse_settings
from tma_ray.envs.catalogue import ENVIRONMENTS
from tma_ray.support.component_names import split_name
from tma_ray.tasks import MASTERY_RETURN, TaskSpace

Environment = gymnasium.Env[Any, Any]
"""Any Gymnasium environment with the attributes `task_space` and `valid_domain` (TaskSpace) whose `reset`
takes ``options={"task": …}``. It may have an attribute `mastery_return`, the episodic return over which a
task counts as mastered, and `observation_signals` and `action_signals`, which tell what the values mean
(sequences of `Signal`)."""

JSON_TYPES = (str, int, float, list, dict)
"""Types in which the options of a run are kept, whatever their annotations."""

GYMNASIUM_IDS = {
    "tma_ray/StumpTracks-v0": ("tma_ray.envs.stump_tracks:StumpTracks", "tma_ray.envs.vector:stump_tracks"),
    "tma_ray/Parkour-v0": ("tma_ray.envs.parkour:Parkour", "tma_ray.envs.vector:parkour"),
}
"""Names for `gymnasium.make` and `gymnasium.make_vec`. Environments truncate their episodes themselves."""


def register_environments() -> None:
    """Register the environments with gymnasium; called when this module is imported."""
    for name, (one, many) in GYMNASIUM_IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name, entry_point=one, vector_entry_point=many, reward_threshold=MASTERY_RETURN
            )


def make_environment(name: str, **kwargs: Any) -> Environment:
    """Return a new environment.

    Args:
        name: a name in ENVIRONMENTS, or ``module:Name``, with options if wanted
            (``parkour:swinging_creepers=true``).
        kwargs: for its constructor, such as `embodiment` and `render_mode`; they take precedence over options
            after the name. Values of JSON stand for those of their annotations, as a text for an enum.

    Raises:
        UnknownNameError: nothing answers to `name`.
        ValueError: an option that it does not have, a value of another type, or an environment without a task
            space, with which no teacher could work.
    """
    base, text = split_name(name)
    kind: Callable[..., Environment] = ENVIRONMENTS.get(base)
    options = {option: value for option, value in text.items() if option not in kwargs}
    known = parameters_of(kind)
    given = {
        option: coerce(option, value, known[option].annotation, "option")
        if option in known and isinstance(value, JSON_TYPES)
        else value
        for option, value in kwargs.items()
    }
    environment = kind(**parse_settings(kind, options, kind="option"), **given)
    for attribute in ("task_space", "valid_domain"):
        declared = environment.has_wrapper_attr(attribute)
        if not declared or not isinstance(environment.get_wrapper_attr(attribute), TaskSpace):
            raise ValueError(f"environment {name!r} must have an attribute {attribute} of type TaskSpace")
    return environment


def mastery_return(environment: Environment) -> float:
    """Return the episodic return over which a task of `environment` is mastered.

    That is its attribute `mastery_return`; without one, the benchmark's.

    Raises:
        ValueError: the attribute is not a finite number.
    """
    if not environment.has_wrapper_attr("mastery_return"):
        return MASTERY_RETURN
    value = environment.get_wrapper_attr("mastery_return")
    if not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"mastery_return = {value!r} of {environment}: expected a finite number")
    return float(value)


register_environments()
