"""Base class of students on top of stable-baselines3: random generators, updates and checkpoints."""

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
    """Context manager that makes float32 torch's default data type, whatever plug-ins have set."""
    previous = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        yield
    finally:
        torch.set_default_dtype(previous)


class TorchStream:
    """State of torch's global generator for one student, restored while stable-baselines3 runs.

    stable-baselines3 draws initial weights and sampled actions from the global generator, shared with other
    students and teachers of the process. The generator of a GPU is included.
    """

    def __init__(self, seed: np.random.SeedSequence, device: torch.device) -> None:
        number = int(seed.generate_state(1)[0])
        self._gpus = [device] if device.type != "cpu" else []
        generators = [torch.Generator(source) for source in (torch.device("cpu"), *self._gpus)]
        self.state = [generator.manual_seed(number).get_state() for generator in generators]

    @contextmanager
    def active(self) -> Iterator[None]:
        """Context manager in which torch draws from this stream, under `single_precision`."""
        kind = self._gpus[0].type if self._gpus else "cuda"
        with single_precision(), torch.random.fork_rng(self._gpus, device_type=kind):
            torch.set_rng_state(self.state[0])
            for device, state in zip(self._gpus, self.state[1:], strict=True):
                torch.get_device_module(device).set_rng_state(state, device)
            try:
                yield
            finally:
                states = [torch.get_device_module(gpu).get_rng_state(gpu) for gpu in self._gpus]
                self.state = [torch.get_rng_state(), *states]


skip_dynamo()


H = TypeVar("H", bound=Any)
M = TypeVar("M", bound=BaseAlgorithm)


class StableBaselinesStudent(ActingStudent, Generic[H, M]):
    """Student that uses the policy and the update of a stable-baselines3 model."""

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
        """Return a new model whose networks are not built yet."""

    @abstractmethod
    def _connect(self) -> None:
        """Clear the experience buffer, and connect it and the acting network to the new `self.model`."""

    @abstractmethod
    def _refresh(self) -> None:
        """Copy the parameters of `self.model` to the acting networks."""

    def _prepare_update(self) -> None:
        """Create the object that updates `self.model`, whose parameters or optimisers have been replaced."""

    @abstractmethod
    def _save_experience(self, folder: Path, incremental: bool, /) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Write buffers and statistics; return counters (JSON) and the names of files left unwritten."""

    @abstractmethod
    def _load_experience(self, folder: Path, counters: dict[str, Any], /) -> None:
        """Load the files and counters that `_save_experience` saved."""

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:  # noqa: D102
        counters, unchanged = self._save_experience(folder, incremental)
        state = {
            "hyperparameters": config_dict(self.hyperparameters),
            "generators": [generator.bit_generator.state for generator in self._generators],
            "updates": self.model._n_updates,
            "counters": counters,
        }
        (folder / "student.json").write_text(json.dumps(state, indent=1))
        # tensors that belong to no module, such as a learned entropy coefficient
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
        saved, config = state["hyperparameters"], config_dict(self.hyperparameters)
        if saved != config:
            pairs = ((key, saved.get(key, "none"), config.get(key, "none")) for key in {**saved, **config})
            differences = ", ".join(f"{key} {old}, here {new}" for key, old, new in pairs if old != new)
            raise ValueError(f"{folder}: saved by a student with other hyper-parameters: {differences}")
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
        """Set the number of updates and refresh the acting networks; call this after changing parameters."""
        self.model._n_updates = updates
        self._refresh()

    @contextmanager
    def _updating(self) -> Iterator[None]:
        """Context manager for updates, with the student's torch stream and precision.

        On exit, the acting networks are refreshed.
        """
        previous = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(self.hyperparameters.matmul_precision)
        try:
            with self._torch_stream.active():
                yield
        finally:
            torch.set_float32_matmul_precision(previous)
        self._refresh()
