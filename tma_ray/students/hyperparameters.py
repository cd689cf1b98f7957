"""Hyper-parameters of the students, checked on construction without importing torch."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Final

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.support.validation import check_at_least, check_positive, check_shares


class MatmulPrecision(StrEnum):
    """Precision of torch's float32 matrix products during updates.

    Attributes:
        HIGHEST: float32 throughout.
        HIGH: rounded to TensorFloat32 (10 bits of mantissa), summed in float32, where a GPU has tensor cores
            for it; no different on a CPU.
        MEDIUM: rounded to bfloat16, summed in float32: about twice as fast where the processor has AMX or
            the GPU has tensor cores, and no different where torch has no such kernels.
    """

    HIGHEST = "highest"
    HIGH = "high"
    MEDIUM = "medium"


@dataclass(frozen=True)
class PPOHyperparameters:
    """Hyper-parameters of proximal policy optimisation (paper, appendix on DRL students).

    The defaults are the paper's. The preset "decisive", chosen in ``docs/pilot.md``, separates teachers best:
    longer rollouts, smaller batches and a longer horizon.

    Attributes:
        algorithm_version: version of the student's algorithm, readable without torch.
        absent_at_default: hyper-parameters added later, left out of run ids at their defaults.
        presets: values of several hyper-parameters by the name of a ``preset``.
        hidden_units: units per hidden layer of the shared trunk, or of each separate one.
        activation: activation of the hidden layers; ReLU as in the paper (the original release: tanh).
        separate_trunks: True if policy and value share no layer.
        learning_rate: Adam's step size, constant; its epsilon is 1e-5 (the release).
        steps_per_update: environment steps between two updates (the release's launch files: 20,000).
        epochs: passes over those steps in one update.
        batch_size: steps per mini-batch.
        gamma: discount factor, also of the returns whose variance scales the rewards.
        gae_lambda: lambda of the generalised advantage estimator.
        clip_range: clip range of the probability ratio.
        value_clip_range: clip range of the value's change per update, in units of the normalised return
            (as in the release; the paper leaves it open); None turns it off.
        value_coefficient: weight of the value's mean squared error in the loss.
        entropy_coefficient: weight of the policy's entropy in the loss.
        max_gradient_norm: norm to which the gradient is clipped.
        observation_clip: normalised observations are clipped to [-x, x].
        reward_clip: normalised rewards are clipped to [-x, x].
        averaged_steps: environment steps of the exponential moving average of the weights, which evaluations
            and the saved policy use; 0 for no average.
        matmul_precision: precision of the updates' matrix products.
    """

    algorithm_version: ClassVar[int] = 1
    absent_at_default: ClassVar[frozenset[str]] = frozenset(
        ("activation", "separate_trunks", "averaged_steps")
    )
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "decisive": {"steps_per_update": 20_000, "batch_size": 500, "gamma": 0.995}
    }

    hidden_units: tuple[int, ...] = (400, 300)
    activation: Activation = Activation.RELU
    separate_trunks: bool = False
    learning_rate: float = 3e-4
    steps_per_update: int = 2_000
    epochs: int = 5
    batch_size: int = 1_000
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    value_clip_range: float | None = 0.2
    value_coefficient: float = 0.5
    entropy_coefficient: float = 0.0
    max_gradient_norm: float = 0.5
    observation_clip: float = 10.0
    reward_clip: float = 10.0
    averaged_steps: int = 0
    matmul_precision: MatmulPrecision = MatmulPrecision.HIGHEST

    def __post_init__(self) -> None:
        check_positive(
            self,
            *("learning_rate", "epochs", "clip_range", "value_clip_range", "max_gradient_norm"),
            *("observation_clip", "reward_clip"),
        )
        check_shares(self, "gamma", "gae_lambda")
        _check_hidden_units(self.hidden_units)
        if not 1 < self.batch_size <= self.steps_per_update or self.steps_per_update % self.batch_size:
            raise ValueError(
                f"batch_size = {self.batch_size}: expected more than 1 and a divisor of "
                f"steps_per_update = {self.steps_per_update}"
            )
        check_at_least(self, 0, "averaged_steps")

    def layout(self, inputs: int, actions: int) -> Layout:
        """Return the layout of the network that maps observations to action means and the value.

        Separate trunks are stored as one of twice the units, masked by `Layout.trunks`.
        """
        hidden = (units * (1 + self.separate_trunks) for units in self.hidden_units)
        return Layout((inputs, *hidden, actions + 1), self.activation)

    @property
    def averaging(self) -> float:
        """Weight of the current parameters in the moving average of parameters."""
        return -math.expm1(-self.steps_per_update / self.averaged_steps)


class LogStd(StrEnum):
    """Map from the actor's output to the log standard deviation, within [-20, 2].

    Attributes:
        TANH: scaled tanh; about -9 at the start (Spinning Up 0.1.1).
        CLAMP: clamped to the range; about 0 at the start (stable-baselines3).
    """

    TANH = "tanh"
    CLAMP = "clamp"


class UpdateSchedule(StrEnum):
    """Schedule of SAC's updates.

    Attributes:
        EPISODE_END: ceil(length / `steps_per_update`) updates at the end of each episode (Spinning Up 0.1.1).
        INTERLEAVED: one update every `steps_per_update` steps, after the initial uniform actions.
    """

    EPISODE_END = "episode_end"
    INTERLEAVED = "interleaved"


@dataclass(frozen=True)
class SACHyperparameters:
    """Hyper-parameters of soft actor-critic (paper, appendix on DRL students).

    The entropy coefficient is fixed.

    Attributes:
        algorithm_version: version of the student's algorithm, readable without torch.
        hidden_units: units per hidden layer of the actor and of each critic, ReLU.
        learning_rate: Adam's step size of actor and critics.
        buffer_size: transitions kept for replay.
        batch_size: transitions per update.
        exploration_steps: environment steps of uniform actions at the start of the run, not repeated after a
            reset (as in the release).
        steps_per_update: environment steps per update.
        updates: schedule of the updates.
        log_std: map from the actor's output to the log standard deviation.
        gamma: discount factor.
        target_rate: rate tau of the target critics' updates.
        entropy_coefficient: weight alpha of the policy's entropy in the return.
        value_samples: actions per state in the estimate of V(s) = E[min Q - alpha log pi].
        matmul_precision: precision of the updates' matrix products.
    """

    algorithm_version: ClassVar[int] = 1

    hidden_units: tuple[int, ...] = (400, 300)
    learning_rate: float = 1e-3
    buffer_size: int = 2_000_000
    batch_size: int = 1_000
    exploration_steps: int = 10_000
    steps_per_update: int = 10
    updates: UpdateSchedule = UpdateSchedule.EPISODE_END
    log_std: LogStd = LogStd.TANH
    gamma: float = 0.99
    target_rate: float = 0.005
    entropy_coefficient: float = 0.005
    value_samples: int = 16
    matmul_precision: MatmulPrecision = MatmulPrecision.HIGHEST

    def layout(self, inputs: int, actions: int) -> Layout:
        """Return the layout of the actor, which maps observations to means and log standard deviations."""
        return Layout((inputs, *self.hidden_units, 2 * actions))

    def __post_init__(self) -> None:
        check_positive(
            self, "learning_rate", "buffer_size", "batch_size", "steps_per_update", "value_samples"
        )
        check_shares(self, "gamma", "target_rate")
        _check_hidden_units(self.hidden_units)
        check_at_least(self, 0, "exploration_steps", "entropy_coefficient")


def _check_hidden_units(units: tuple[int, ...]) -> None:
    if not units or min(units) < 1:
        raise ValueError(f"hyper-parameter hidden_units = {units}: expected at least one layer of 1 or more")


ALGORITHMS: Final[Mapping[str, str]] = {
    "A2C": "stable_baselines3",
    "CrossQ": "sb3_contrib",
    "DDPG": "stable_baselines3",
    "TD3": "stable_baselines3",
    "TQC": "sb3_contrib",
    "TRPO": "sb3_contrib",
}
"""Module of each non-recurrent algorithm for continuous actions; PPO and SAC have their own students."""

PACKAGES: Final[Mapping[str, str]] = {"stable_baselines3": "stable-baselines3", "sb3_contrib": "sb3-contrib"}
"""Name of the package that provides each module, for installation."""
