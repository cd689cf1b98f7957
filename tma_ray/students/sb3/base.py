"""The base of PPO and SAC: models of stable-baselines3 with our environment loop, randomness and files."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import torch
from gymnasium import Space
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from tma_ray.hyperparameters import identifying
from tma_ray.optimisers import leave_compiler_out
from tma_ray.students.base import Student, StudentStreams, checked_spaces
from tma_ray.students.hyperparameters import MatmulPrecision
from tma_ray.students.policy_files import write_policy


class TorchStream:
    """A state of torch's global generator, swapped in only while stable-baselines3 runs.

    stable-baselines3 initialises weights and samples actions in its updates from the global
    generator. With this, two students in a process, or a teacher with networks of its own, do not
    disturb each other.

    Args:
        seed: seeds the stream.
        device: device, whose generator is swapped, too, if it is a GPU.
    """

    def __init__(self, seed: np.random.SeedSequence, device: torch.device) -> None:
        self._device = device
        number = int(seed.generate_state(1)[0])
        devices = [torch.device("cpu"), device] if device.type != "cpu" else [device]
        generators = [torch.Generator(each) for each in devices]
        self.state = [generator.manual_seed(number).get_state() for generator in generators]

    @contextmanager
    def active(self) -> Iterator[None]:
        """Make torch draw from this stream inside the block, and as before after it."""
        outside = self._current()
        self._use(self.state)
        try:
            yield
        finally:
            self.state = self._current()
            self._use(outside)

    def _current(self) -> list[torch.Tensor]:
        states = [torch.get_rng_state()]
        if self._device.type != "cpu":
            states.append(torch.get_device_module(self._device).get_rng_state(self._device))
        return states

    def _use(self, states: list[torch.Tensor]) -> None:
        torch.set_rng_state(states[0])
        if self._device.type != "cpu":
            torch.get_device_module(self._device).set_rng_state(states[1], self._device)


leave_compiler_out()


class Hyperparameters(Protocol):
    """Hyper-parameters that all these students have."""

    @property
    def gamma(self) -> float:
        """Discount factor."""

    @property
    def matmul_precision(self) -> MatmulPrecision:
        """Precision of the updates' matrix products."""


H = TypeVar("H", bound=Hyperparameters)
M = TypeVar("M", bound=BaseAlgorithm)


class Experience(NamedTuple):
    """State of saved buffers and statistics.

    Attributes:
        counters: values that are saved as JSON.
        unchanged: files left out of an incremental save.
    """

    counters: dict[str, Any]
    unchanged: tuple[str, ...] = ()


class StableBaselinesStudent(Student, Generic[H, M]):
    """A student whose policy and update are stable-baselines3's.

    The seed's children are, in this order: torch's stream (weights, actions sampled in updates),
    exploration, mini-batches, state values.

    Args:
        observation_space: a one-dimensional box, of size o.
        action_space: a bounded one-dimensional box, of size a.
        hyperparameters: hyper-parameters of the algorithm.
        seed: source of all randomness; not changed.
        device: torch's name of the device of the networks.
        threads: number of torch's threads, which all students of the process share.

    Raises:
        ValueError: a space that is not such a box.
    """

    def __init__(
        self,
        observation_space: Space[Any],
        action_space: Space[Any],
        hyperparameters: H,
        seed: np.random.SeedSequence,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        self.observation_space, self.action_space = checked_spaces(observation_space, action_space)
        self._low = np.asarray(self.action_space.low, dtype=np.float32)
        self._high = np.asarray(self.action_space.high, dtype=np.float32)
        self.hyperparameters = hyperparameters
        self.gamma = hyperparameters.gamma
        self.device = torch.device(device)
        torch.set_num_threads(threads)
        streams = StudentStreams.of(seed)
        self._torch_stream = TorchStream(streams.networks, self.device)
        self._exploration = np.random.default_rng(streams.exploration)
        self._batches = np.random.default_rng(streams.batches)
        self._values = np.random.default_rng(streams.values)
        self._start()
        self._build()

    @abstractmethod
    def _start(self) -> None:
        """Make what lives as long as the student: statistics, counters and empty buffers."""

    @abstractmethod
    def _make_model(self) -> M:
        """Return a new model whose networks are not yet built."""

    @abstractmethod
    def _connect(self) -> None:
        """Empty the buffer and join it, updates and acting to `self.model`, which is new."""

    @abstractmethod
    def _refresh(self) -> None:
        """Copy the parameters of `self.model`, which have changed, to wherever copies are kept."""

    @abstractmethod
    def _save_experience(self, folder: Path, incremental: bool, /) -> Experience:
        """Write buffers and statistics into `folder`; `incremental` as for `save`."""

    @abstractmethod
    def _load_experience(self, folder: Path, counters: dict[str, Any], /) -> None:
        """Load what `_save_experience` wrote, and the counters that it returned."""

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:  # noqa: D102
        experience = self._save_experience(folder, incremental)
        state = {
            "hyperparameters": self._settings,
            "generators": [generator.bit_generator.state for generator in self._generators],
            "updates": self.model._n_updates,
            "counters": experience.counters,
        }
        (folder / "student.json").write_text(json.dumps(state, indent=1))
        networks = {
            "parameters": self.model.get_parameters(),
            "variables": {name: getattr(self.model, name).detach() for name in self._variables},
            "torch_stream": self._torch_stream.state,
        }
        torch.save(networks, folder / "networks.pt")
        return experience.unchanged

    def load(self, folder: Path) -> None:  # noqa: D102
        state = json.loads((folder / "student.json").read_text())
        saved, ours = state["hyperparameters"], self._settings
        if saved != ours:
            differing = [key for key in {**saved, **ours} if saved.get(key, "none") != ours.get(key, "none")]
            raise ValueError(
                f"{folder}: saved by a student with other hyper-parameters: "
                + ", ".join(
                    f"{key} {saved.get(key, 'none')}, here {ours.get(key, 'none')}" for key in differing
                )
            )
        networks = torch.load(folder / "networks.pt", map_location="cpu", weights_only=True)
        self.model.set_parameters(networks["parameters"], device=self.device)
        for name, value in networks["variables"].items():
            getattr(self.model, name).data.copy_(value)
        self._torch_stream.state = networks["torch_stream"]
        for generator, saved in zip(self._generators, state["generators"], strict=True):
            generator.bit_generator.state = saved
        self.model._n_updates = state["updates"]
        self._load_experience(folder, state["counters"])
        self._restore_update()
        self._refresh()

    def reset(self) -> None:  # noqa: D102
        self._build()

    def scalars(self) -> dict[str, float]:  # noqa: D102
        recorded = self.model.logger.name_to_value
        return {name.removeprefix("train/"): float(value) for name, value in recorded.items()}

    def _restore_update(self) -> None:
        """Read the optimisers' states after they were loaded; stable-baselines3's own need nothing."""

    @contextmanager
    def _updating(self) -> Iterator[None]:
        """Context of the student's torch stream and precision; refreshes copied parameters at its end."""
        outside = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(self.hyperparameters.matmul_precision)
        try:
            with self._torch_stream.active():
                yield
        finally:
            torch.set_float32_matmul_precision(outside)
        self._refresh()

    def _write_policy(
        self, folder: Path, kind: str, tensors: Mapping[str, NDArray[Any]], hyperparameters: Mapping[str, Any]
    ) -> None:
        """Write a policy of the `kind` between this student's spaces."""
        write_policy(folder, kind, self.observation_space, self.action_space, tensors, hyperparameters)

    @property
    def _variables(self) -> list[str]:
        """Names of the model's tensors that belong to no module, such as a learned entropy coefficient."""
        return list(self.model._get_torch_save_params()[1])

    @property
    def _settings(self) -> dict[str, Any]:
        """Hyper-parameters as states have them: a file by its name, since each process has it elsewhere."""
        values = identifying(self.hyperparameters)
        return {key: Path(value).name if key == "start_from" else value for key, value in values.items()}

    @property
    def _generators(self) -> list[np.random.Generator]:
        return [self._exploration, self._batches, self._values]

    def _noise(self) -> NDArray[np.float32]:
        """Draw the standard normal noise (a,) of one exploring action."""
        return self._exploration.standard_normal(self._low.size, dtype=np.float32)

    def _build(self) -> None:
        """Make a new model with new networks and optimisers."""
        self.model = self._make_model()
        self.model.observation_space = self.observation_space
        self.model.action_space = self.action_space
        self.model.n_envs = 1
        with self._torch_stream.active():
            self.model._setup_model()
        self.model.set_logger(Logger(folder=None, output_formats=[]))
        self._connect()
