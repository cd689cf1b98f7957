"""One fused Adam step over flat parameters, on behalf of the optimiser that a saved model names."""

from __future__ import annotations

import torch

from tma_ray.optimisers import take_step
from tma_ray.students.mlp.modules import FlatParameters


class FlatAdam:
    """Steps `flat` as `optimiser` would, and keeps the optimiser's state: it is saved and loaded as ever.

    Args:
        optimiser: Adam over the same parameters, in any order.
        flat: the parameters.
    """

    def __init__(self, optimiser: torch.optim.Optimizer, flat: FlatParameters) -> None:
        (group,) = optimiser.param_groups
        assert isinstance(optimiser, torch.optim.Adam)
        assert {id(own) for own in group["params"]} == {id(own) for own in flat.parameters}
        self._optimiser, self._flat = optimiser, flat
        flat.values.grad = flat.gradient
        settings = {key: group[key] for key in ("lr", "betas", "eps", "weight_decay")}
        self._adam = torch.optim.Adam([flat.values], fused=True, **settings)
        self.restore()

    def step(self) -> None:
        """Moves the parameters against `flat.gradient`."""
        if not self._optimiser.state:
            self._share(0.0)
        take_step(self._adam)
        self._steps += 1

    @property
    def moments(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Running means of the gradient and of its square (p,); zeros before the first step."""
        return self._mean, self._square

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return int(self._steps[0])

    def put(self, mean: torch.Tensor, square: torch.Tensor, steps: int) -> None:
        """Takes over moments (p,) and a number of steps, of an optimiser elsewhere."""
        self._mean.copy_(mean)
        self._square.copy_(square)
        if steps:
            self._share(float(steps))
        else:
            self._optimiser.state.clear()

    def restore(self) -> None:
        """Takes over the optimiser's state after it was loaded."""
        self._mean, self._square = (torch.zeros_like(self._flat.values) for _ in range(2))
        # one step count per parameter, as Adam has it, each with its own place in memory
        self._steps = torch.zeros(len(self._flat.parameters), dtype=torch.float32)
        loaded = self._optimiser.state
        if loaded:
            for name, buffer in (("exp_avg", self._mean), ("exp_avg_sq", self._square)):
                parts = [loaded[own][name].reshape(-1) for own in self._flat.parameters]
                torch.cat(parts, out=buffer)
            self._share(float(loaded[self._flat.parameters[0]]["step"]))

    def _share(self, steps: float) -> None:
        """Makes the optimiser's state views of the buffers that `step` writes."""
        self._steps.fill_(steps)
        views = self._flat.views(self._mean), self._flat.views(self._square)
        for own, step, mean, square in zip(self._flat.parameters, self._steps, *views, strict=True):
            self._optimiser.state[own] = {"step": step, "exp_avg": mean, "exp_avg_sq": square}
        self._adam.state[self._flat.values] = {
            "step": torch.tensor(steps, dtype=torch.float32, device=self._flat.values.device),
            "exp_avg": self._mean,
            "exp_avg_sq": self._square,
        }
