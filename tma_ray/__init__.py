"""tma_ray: fair, distributed comparison of automatic curriculum learning teachers."""

__version__ = "0.1.0"
