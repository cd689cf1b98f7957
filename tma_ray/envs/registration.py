"""Registration of the environments with gymnasium, and creation of environments by name."""

import math
from collections.abc import Callable
from numbers import Real
from typing import Any

import gymnasium
from gymnasium import spaces

from tma_ray.components.settings import coerce, parameters_of, parse_settings
from tma_ray.envs.catalogue import ENVIRONMENTS
from tma_ray.support.component_names import split_name
from tma_ray.tasks import MASTERY_RETURN, TaskSpace

Environment = gymnasium.Env[Any, Any]
"""Gymnasium environment with the attributes `task_space` and `valid_domain` (TaskSpace) whose `reset` takes
``options={"task": …}``. Optional attributes are `mastery_return`, the episodic return over which a task is
mastered, and `observation_signals` and `action_signals` (sequences of `Signal`)."""

JSON_TYPES = (str, int, float, list, dict)  # types of options in run specs

GYMNASIUM_IDS = {
    "tma_ray/StumpTracks-v0": ("tma_ray.envs.stump_tracks:StumpTracks", "tma_ray.envs.vector:stump_tracks"),
    "tma_ray/Parkour-v0": ("tma_ray.envs.parkour:Parkour", "tma_ray.envs.vector:parkour"),
}
"""Entry points for `gymnasium.make` and `gymnasium.make_vec` by id; episodes need no `TimeLimit`."""


def register_environments() -> None:
    """Register the benchmark's environments with gymnasium, if they are not registered yet."""
    for name, (single, vector) in GYMNASIUM_IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name, entry_point=single, vector_entry_point=vector, reward_threshold=MASTERY_RETURN
            )


def make_environment(name: str, **kwargs: Any) -> Environment:
    """Return a new environment called `name`.

    Args:
        name: a name in ENVIRONMENTS, or ``module:Name``, with optional settings
            (``parkour:swinging_creepers=true``).
        kwargs: arguments of its constructor, such as `embodiment` and `render_mode`, which take precedence
            over settings in the name. JSON values are converted to annotated types, as a text to an enum.

    Raises:
        UnknownNameError: if `name` is unknown.
        ValueError: if an option is unknown or of another type, or the environment has no task space.
    """
    base, text = split_name(name)
    kind: Callable[..., Environment] = ENVIRONMENTS.get(base)
    options = {option: value for option, value in text.items() if option not in kwargs}
    parameters = parameters_of(kind)
    arguments = {
        option: coerce(option, value, parameters[option].annotation, "option")
        if option in parameters and isinstance(value, JSON_TYPES)
        else value
        for option, value in kwargs.items()
    }
    environment = kind(**parse_settings(kind, options, kind="option"), **arguments)
    for attribute in ("task_space", "valid_domain"):
        declared = environment.has_wrapper_attr(attribute)
        if not declared or not isinstance(environment.get_wrapper_attr(attribute), TaskSpace):
            raise ValueError(f"environment {name!r} must have an attribute {attribute} of type TaskSpace")
    return environment


def box_spaces(environment: Environment) -> tuple[spaces.Box, spaces.Box]:
    """Return the observation space and the action space of `environment`, which must be boxes.

    Raises:
        ValueError: if they are not boxes.
    """
    observations, actions = environment.observation_space, environment.action_space
    if not (isinstance(observations, spaces.Box) and isinstance(actions, spaces.Box)):
        raise ValueError(f"{environment} has spaces {observations}, {actions}; expected boxes")
    return observations, actions


def mastery_return(environment: Environment) -> float:
    """Return the episodic return over which a task of `environment` is mastered.

    Raises:
        ValueError: if the environment's attribute is not a finite number.
    """
    if not environment.has_wrapper_attr("mastery_return"):
        return MASTERY_RETURN
    value = environment.get_wrapper_attr("mastery_return")
    if not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"mastery_return = {value!r} of {environment}: expected a finite number")
    return float(value)


register_environments()
