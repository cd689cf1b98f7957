"""A student's own random streams, apart from the process's global generators."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


class TorchStream:
    """A state of torch's global generator, swapped in only while stable-baselines3 runs.

    stable-baselines3 initialises weights and samples actions in its updates from the global
    generator. With this, two students in a process, or a teacher with networks of its own, do not
    disturb each other.

    Args:
        seed: seeds the stream.
        device: with a GPU its generator is swapped, too.
    """

    def __init__(self, seed: np.random.SeedSequence, device: torch.device) -> None:
        self._device = device
        number = int(seed.generate_state(1)[0])
        devices = [torch.device("cpu"), device] if device.type != "cpu" else [device]
        generators = [torch.Generator(each) for each in devices]
        self.state = [generator.manual_seed(number).get_state() for generator in generators]

    @contextmanager
    def active(self) -> Iterator[None]:
        """Makes torch draw from this stream inside the block, and as before after it."""
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
