"""tma_ray: fair, distributed comparison of automatic curriculum learning teachers.

Importing it makes the environments known to `gymnasium.make`.
"""

from importlib import import_module
from sys import orig_argv

from tma_ray.commands.interrupts import expect_early, is_command

__version__ = "0.1.0"

if is_command(orig_argv):  # starts at once; what it does with environments makes them known
    expect_early()
else:
    import_module("tma_ray.envs.registration")
