"""Torch's optimisers without torch's compiler, which they would import though nothing is compiled.

That import takes a process 2 s and 150 MB. What optimisers compute stays the same.
"""

from inspect import unwrap

import torch
from torch.optim import Optimizer

UNCOMPILED = (Optimizer.add_param_group, Optimizer.state_dict, Optimizer.load_state_dict)
"""What torch keeps from being compiled, and imports the compiler for at the first call."""


def skip_dynamo() -> None:
    """Let optimisers of this process be made, saved and loaded without the compiler.

    Plug-ins that compile import it by themselves. Without the attribute, which is torch's own and
    not public, all is as slow as before.
    """
    for method in UNCOMPILED:
        plain = unwrap(method)
        vars(plain).setdefault("__dynamo_disable", plain)


def take_step(optimiser: Optimizer) -> None:
    """Take one step of `optimiser`, as its own method does, without hooks."""
    with torch.no_grad():
        unwrap(type(optimiser).step)(optimiser)
