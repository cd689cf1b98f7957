"""Bodies as data: parts, joints, motors; read from one file each, with parameters."""

from tma_ray.embodiments.embodiment import BodyType, Embodiment, EmbodimentError
from tma_ray.embodiments.loading import embodiment_names, load_embodiment
from tma_ray.embodiments.parts import Joint, Part
from tma_ray.embodiments.polygon import Point, Polygon

__all__ = [
    "BodyType",
    "Embodiment",
    "EmbodimentError",
    "Joint",
    "Part",
    "Point",
    "Polygon",
    "embodiment_names",
    "load_embodiment",
]
