"""The base of PPO and SAC: models of stable-baselines3 with our environment loop, randomness and files."""

import json
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from gymnasium import Space
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from tma_ray.components.settings import config_dict
from tma_ray.students.base import checked_spaces
from tma_ray.students.rollout_workers.base import ActingStudent
from tma_ray.support.import_hacks import skip_dynamo


@contextmanager
def single_precision() -> Iterator[None]:
    """Make float32 torch's default type inside the block, whatever plug-ins of this process have made it."""
    outside = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        yield
    finally:
        torch.set_default_dtype(outside)


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
        number = int(seed.generate_state(1)[0])
        self._gpus = [device] if device.type != "cpu" else []
        generators = [torch.Generator(each) for each in (torch.device("cpu"), *self._gpus)]
        self.state = [generator.manual_seed(number).get_state() for generator in generators]

    @contextmanager
    def active(self) -> Iterator[None]:
        """Make torch draw from this stream in the block, in `single_precision`, and as before after it."""
        kind = self._gpus[0].type if self._gpus else "cuda"
        with single_precision(), torch.random.fork_rng(self._gpus, device_type=kind):
            torch.set_rng_state(self.state[0])
            for device, state in zip(self._gpus, self.state[1:], strict=True):
                torch.get_device_module(device).set_rng_state(state, device)
            try:
                yield
            finally:
                states = [torch.get_device_module(each).get_rng_state(each) for each in self._gpus]
                self.state = [torch.get_rng_state(), *states]


skip_dynamo()


H = TypeVar("H", bound=Any)
M = TypeVar("M", bound=BaseAlgorithm)


class StableBaselinesStudent(ActingStudent, Generic[H, M]):
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
        boxes = checked_spaces(observation_space, action_space)
        streams = self._set_up(*boxes, hyperparameters, seed)
        self.device = torch.device(device)
        torch.set_num_threads(threads)
        self._torch_stream = TorchStream(streams.networks, self.device)
        self._start()
        self.reset()

    @abstractmethod
    def _make_model(self) -> M:
        """Return a new model whose networks are not yet built."""

    @abstractmethod
    def _connect(self) -> None:
        """Empty the buffer and join it, updates and acting to `self.model`, which is new."""

    @abstractmethod
    def _refresh(self) -> None:
        """Copy the parameters of `self.model`, which have changed, to wherever copies are kept."""

    def _prepare_update(self) -> None:
        """Make what updates need of `self.model`, whose parameters and optimisers' states are new."""

    @abstractmethod
    def _save_experience(self, folder: Path, incremental: bool, /) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Write buffers and statistics into `folder`; `incremental` as for `save`.

        Returns:
            Counters, which are saved as JSON, and the files that were left out.
        """

    @abstractmethod
    def _load_experience(self, folder: Path, counters: dict[str, Any], /) -> None:
        """Load what `_save_experience` wrote, and the counters that it returned."""

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:  # noqa: D102
        counters, unchanged = self._save_experience(folder, incremental)
        state = {
            "hyperparameters": config_dict(self.hyperparameters),
            "generators": [generator.bit_generator.state for generator in self._generators],
            "updates": self.model._n_updates,
            "counters": counters,
        }
        (folder / "student.json").write_text(json.dumps(state, indent=1))
        # tensors of the model that belong to no module, such as a learned entropy coefficient
        variables = self.model._get_torch_save_params()[1]
        networks = {
            "parameters": self.model.get_parameters(),
            "variables": {name: getattr(self.model, name).detach() for name in variables},
            "torch_stream": self._torch_stream.state,
        }
        torch.save(networks, folder / "networks.pt")
        return unchanged

    def load(self, folder: Path) -> None:  # noqa: D102
        state = json.loads((folder / "student.json").read_text())
        saved, ours = state["hyperparameters"], config_dict(self.hyperparameters)
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
        self._prepare_update()
        self._refresh()

    def reset(self) -> None:  # noqa: D102
        self.model = self._make_model()
        self.model.observation_space = self.observation_space
        self.model.action_space = self.action_space
        self.model.n_envs = 1
        with self._torch_stream.active():
            self.model._setup_model()
        self.model.set_logger(Logger(folder=None, output_formats=[]))
        self._connect()
        self._prepare_update()
        self._refresh()

    def changed(self, updates: int) -> None:
        """Load parameters that were changed from outside, by so many `updates` in all."""
        self.model._n_updates = updates
        self._refresh()

    def scalars(self) -> dict[str, float]:  # noqa: D102
        recorded = self.model.logger.name_to_value
        return {name.removeprefix("train/"): float(value) for name, value in recorded.items()}

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
