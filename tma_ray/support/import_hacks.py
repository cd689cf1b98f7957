"""Workarounds that keep pyarrow from importing pandas, and torch from importing its compiler."""

from __future__ import annotations

import sys
from inspect import unwrap
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch.optim import Optimizer


def skip_pandas() -> None:
    """Prevent pyarrow from importing pandas to convert lists, for the rest of this process.

    Conversion to a data frame still imports pandas. Call it before other threads import anything.
    """
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    def find_spec(name: str, *_: Any) -> None:
        if name == "pandas":
            raise ModuleNotFoundError("pandas is left out", name=name)

    refusal: Any = SimpleNamespace(find_spec=find_spec)
    sys.meta_path.insert(0, refusal)
    try:
        pa.array([0])  # pyarrow looks for pandas only once per process
    finally:
        sys.meta_path.remove(refusal)


def skip_dynamo() -> None:
    """Prevent torch's optimisers from importing torch's compiler when constructed, saved or loaded.

    The import takes 2 s and 150 MB, and optimisers compute the same without it. The attribute is private to
    torch; without it, only the time is lost.
    """
    from torch.optim import Optimizer

    for method in (Optimizer.add_param_group, Optimizer.state_dict, Optimizer.load_state_dict):
        undecorated = unwrap(method)
        vars(undecorated).setdefault("__dynamo_disable", undecorated)


def take_step(optimiser: Optimizer) -> None:
    """Take one step of `optimiser`, bypassing its hooks, which would import torch's compiler."""
    import torch

    with torch.no_grad():
        unwrap(type(optimiser).step)(optimiser)
