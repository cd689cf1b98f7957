"""Bodies as data: parts, joints, motors; read from one file each, with parameters."""

from tma_ray.embodiments.checks import EmbodimentError
from tma_ray.embodiments.embodiment import BodyType, Embodiment, LidarLayout
from tma_ray.embodiments.loading import embodiment_names, load_embodiment
from tma_ray.embodiments.parts import GripSensor, Joint, Part
from tma_ray.embodiments.polygon import Point, Polygon

__all__ = [
    "BodyType",
    "Embodiment",
    "EmbodimentError",
    "GripSensor",
    "Joint",
    "LidarLayout",
    "Part",
    "Point",
    "Polygon",
    "embodiment_names",
    "load_embodiment",
]
