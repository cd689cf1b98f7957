"""Which algorithms of stable-baselines3 and sb3-contrib are students by name. Imports neither of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

ALGORITHMS: Final[Mapping[str, str]] = {
    "A2C": "stable_baselines3",
    "CrossQ": "sb3_contrib",
    "DDPG": "stable_baselines3",
    "TD3": "stable_baselines3",
    "TQC": "sb3_contrib",
    "TRPO": "sb3_contrib",
}
"""Those for continuous actions, without memory, and the module that offers them; PPO and SAC have students
of their own."""

PACKAGES: Final[Mapping[str, str]] = {
    "stable_baselines3": "stable-baselines3",
    "sb3_contrib": "sb3-contrib",
}
"""What to install for a module."""
