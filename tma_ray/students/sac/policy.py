"""stable-baselines3's policy of SAC with a log deviation that is a scaled tangent hyperbolic."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.sac.policies import Actor, SACPolicy

from tma_ray.students.hyperparameters import LogStd
from tma_ray.students.sac.losses import in_range


class TanhActor(Actor):
    """An actor whose log deviation is not clamped, but a tangent hyperbolic scaled to the same range."""

    def get_action_dist_params(
        self, obs: PyTorchObs
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """Returns means (n, a) and log deviations (n, a) of the actions before squashing."""
        latent = self.latent_pi(self.extract_features(obs, self.features_extractor))
        log_std: Any = self.log_std
        return self.mu(latent), in_range(log_std(latent), LogStd.TANH), {}


class TanhPolicy(SACPolicy):
    """A policy with a `TanhActor`."""

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """Returns a new actor."""
        keywords = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return TanhActor(**keywords).to(self.device)


POLICIES: dict[LogStd, type[SACPolicy]] = {LogStd.TANH: TanhPolicy, LogStd.CLAMP: SACPolicy}
"""stable-baselines3's policy for each map to the log deviation."""
