"""Environments that draw frames, with the trained, random or zero policy that acts in them."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from gymnasium import spaces

from tma_ray.commands.arguments import check_fields, check_whole
from tma_ray.envs import ENVIRONMENTS, Environment, make_environment, mastery_return
from tma_ray.runs.inputs import arguments
from tma_ray.runs.saved_policies import SavedPolicy, StepPolicy, find_policy
from tma_ray.tasks import TaskSpace
from tma_ray.viewing.pictures import Frame
from tma_ray.viewing.policies import RANDOM, ZERO, random_policy, zero_policy

DEFAULT_ENVIRONMENT, DEFAULT_EMBODIMENT = "stump_tracks", "classic_bipedal"
FRAME_RATE = 50
"""Frames per second of an environment that does not say."""


@dataclass(frozen=True)
class RenderSettings:
    """Settings of rendering: policy, environment, and how much is shown.

    Attributes:
        policy: "random" (uniform actions), "zero" (all zero), the folder of a saved policy, or a run of
            `results`: its id or an unambiguous beginning of it.
        results: folder or URI of a results root.
        environment: registered name or ``module:Name``; None for that of the run, else Stump Tracks.
        embodiment: name of the body, empty for none; None for that of the run, else the classic bipedal.
        seed: of worlds, random tasks and random actions.
        steps: after which an episode is left, if it has not ended.
        every: steps from one frame to the next.
    """

    policy: str = RANDOM
    results: str | Path = "results"
    environment: str | None = None
    embodiment: str | None = None
    seed: int = 0
    steps: int = 1000
    every: int = 2

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("seed", 0), ("steps", 0), ("every", 1)):
            check_whole(name, getattr(self, name), least)


@dataclass
class RenderedEnvironment:
    """An environment that draws frames, with the policy that acts in it.

    Attributes:
        environment: with the render mode "rgb_array".
        policy: "random", "zero", or the run of a trained one.
        trained: the trained policy, if it is one.
        space: tasks that a teacher may choose.
        domain: tasks that the environment can build.
        threshold: episodic return over which a task is mastered.
    """

    environment: Environment
    policy: str
    trained: StepPolicy | None
    space: TaskSpace
    domain: TaskSpace
    threshold: float

    @property
    def frame_rate(self) -> Fraction:
        """Steps of the environment in a second."""
        return Fraction(self.environment.metadata.get("render_fps", FRAME_RATE))

    def acting_policy(self, rng: np.random.Generator) -> StepPolicy:
        """Returns the policy that acts; `rng` draws random actions."""
        actions = self.environment.action_space
        assert isinstance(actions, spaces.Box)
        if self.trained is not None:
            return self.trained
        return zero_policy(actions) if self.policy == ZERO else random_policy(actions, rng)

    def frame(self) -> Frame:
        """Returns the current frame (height, width, 3)."""
        return np.asarray(self.environment.render(), dtype=np.uint8)

    def close(self) -> None:
        """Closes the environment."""
        self.environment.close()


def open_rendered(settings: RenderSettings) -> RenderedEnvironment:
    """Returns the environment that settings describe, all of which has been checked.

    Raises:
        ValueError: no such policy or one that does not fit, or an environment that cannot be drawn.
    """
    policy = settings.policy
    saved = None if policy in (RANDOM, ZERO) else find_policy(policy, settings.results)
    made = _make(settings.environment, settings.embodiment, saved)
    try:
        observations, actions = made.observation_space, made.action_space
        if not (isinstance(observations, spaces.Box) and isinstance(actions, spaces.Box)):
            raise ValueError(f"{made} has spaces {observations}, {actions}; expected boxes")
        domain: TaskSpace = made.get_wrapper_attr("valid_domain")
        space = made.get_wrapper_attr("task_space") if saved is None else saved.spec.task_space
        if space.names != domain.names:  # the policy of one environment in another
            space = made.get_wrapper_attr("task_space")
        trained = None if saved is None else saved.load(observations, actions)
        return RenderedEnvironment(
            made, saved.spec.run_id if saved else policy, trained, space, domain, mastery_return(made)
        )
    except ValueError:
        made.close()
        raise


def _make(name: str | None, embodiment: str | None, saved: SavedPolicy | None) -> Environment:
    """Returns the environment, which draws frames."""
    spec = saved.spec if saved else None
    name = name or (spec.environment if spec else DEFAULT_ENVIRONMENT)
    known = arguments(spec, "environment") if spec else {}
    options = known if spec and spec.environment == name else {}
    body = embodiment
    if body is None and "embodiment" not in options:
        body = known.get("embodiment", "") if spec else DEFAULT_EMBODIMENT
    if body:
        options["embodiment"] = body
    elif body is not None:
        options.pop("embodiment", None)
    if "rgb_array" not in ENVIRONMENTS.get(name).metadata.get("render_modes", ()):
        raise ValueError(f"environment {name!r} cannot be drawn: it has no render mode 'rgb_array'")
    return make_environment(name, render_mode="rgb_array", **options)
