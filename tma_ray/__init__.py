"""tma_ray: fair, distributed comparison of automatic curriculum learning teachers.

Importing it makes the environments known to `gymnasium.make`.
"""

from tma_ray.commands.early_interrupts import expect_early

expect_early()  # of the command alone: what follows takes a while

from tma_ray.envs.registration import register_environments  # noqa: E402

__version__ = "0.1.0"

register_environments()
