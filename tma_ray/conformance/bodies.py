"""The contract of every body, as a test class that its author inherits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from tma_ray.embodiments import Embodiment, load_embodiment
from tma_ray.envs import make_environment
from tma_ray.physics.kernels import VELOCITY_X_SCALE, VELOCITY_Y_SCALE

STEPS = 200
"""Random steps of a play."""

FASTEST = 100.0
"""Speed of the head over which a body counts as torn apart by its joints, in m/s."""


class BodyConformance:
    """The contract of a body, as tests.

    Inherit from it where pytest looks for tests, and name the body::

        class TestHopper(BodyConformance):
            body = "hopper.toml"

    Every method is a promise; a failure says which, and what to do. pytest is needed to run the class, not to
    import it.

    Attributes:
        body: name of a body or path of its file, with parameters if wanted.
        environments: the environments that it is for.
    """

    body: ClassVar[str]
    environments: ClassVar[Sequence[str]] = ("stump_tracks", "parkour")

    def pytest_generate_tests(self, metafunc: Any) -> None:
        """Tells pytest to run the methods that take an environment for each of them."""
        if "environment" in metafunc.fixturenames:
            metafunc.parametrize("environment", self.environments)

    def test_its_file_is_read(self) -> None:
        """Parts, joints and sensors are consistent, masses positive."""
        loaded = self._loaded()
        for part in loaded.parts:
            assert part.mass > 0, f"a part has mass {part.mass}: check its shape and density"
        assert loaded.action_size > 0, "a body without motors and grips has nothing to learn"

    def test_actions_and_observations_have_meanings(self, environment: str) -> None:
        """Signals name every value, as pages and models show them."""
        made = make_environment(environment, embodiment=self.body)
        for kind in ("observation", "action"):
            signals = made.get_wrapper_attr(f"{kind}_signals")
            size = getattr(made, f"{kind}_space").shape[0]
            assert sum(signal.size for signal in signals) == size, f"{kind}s have {size} values"

    def test_it_stays_together_under_random_actions(self, environment: str) -> None:
        """Observations stay finite, and the head is not shot away by joints that fight each other."""
        for seed in range(3):
            for observation, speed in self._played(environment, seed):
                assert np.isfinite(observation).all(), f"{self.body}: an observation is not finite"
                assert speed < FASTEST, (
                    f"{self.body}: its head moves at {speed:.0f} m/s; check anchors, limits and overlaps"
                )

    def test_seed_and_actions_determine_its_way(self, environment: str) -> None:
        """Bit for bit, in a new instance, too."""
        first, second = (
            [observation.tobytes() for observation, _ in self._played(environment, 1)] for _ in range(2)
        )
        assert first == second, f"{self.body}: the same seed and actions lead elsewhere"

    def test_its_motors_move_it(self, environment: str) -> None:
        """Other actions lead elsewhere."""
        still, moved = (
            np.stack([observation for observation, _ in self._played(environment, 0, scale)])
            for scale in (0.0, 1.0)
        )
        steps = min(len(still), len(moved))
        assert (still[:steps] != moved[:steps]).any(), f"{self.body}: its motors change nothing"

    def _loaded(self) -> Embodiment:
        return load_embodiment(self.body)

    def _played(self, environment: str, seed: int, scale: float = 1.0) -> list[tuple[Any, float]]:
        """Returns observations of an episode on the middle task, and the speed of the head, in m/s."""
        made, rng = make_environment(environment, embodiment=self.body), np.random.default_rng(seed)
        task = made.get_wrapper_attr("task_space").centre
        observation, _ = made.reset(seed=seed, options={"task": task})
        seen, scales = [(observation, 0.0)], np.array([VELOCITY_X_SCALE, VELOCITY_Y_SCALE])
        for _ in range(STEPS):
            action = scale * rng.uniform(-1, 1, made.action_space.shape or ())
            observation, _, terminated, truncated, _ = made.step(action.astype(np.float32))
            seen.append((observation, float(np.abs(observation[2:4] / scales).max())))
            if terminated or truncated:
                break
        return seen
