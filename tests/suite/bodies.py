"""Bodies as parameters of tests: three in the fast tier, all of them in the slow one."""

from typing import Any

import pytest

from tma_ray.embodiments import embodiment_names

FEW = ("classic_bipedal", "fish", "climbing_chimpanzee")
"""A walker, a swimmer and a climber."""


def body(*values: str) -> Any:
    """Return a parameter set, marked slow unless one of its values is in `FEW`."""
    return pytest.param(*values, marks=() if set(values) & set(FEW) else pytest.mark.slow)


def bodies() -> list[Any]:
    """Return the names of all bodies as parameters."""
    return [body(name) for name in embodiment_names()]
