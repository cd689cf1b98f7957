"""Bodies as data (parts, joints, motors), loaded from files with parameters."""

from tma_ray.embodiments.embodiment import (
    BodyType,
    Embodiment,
    EmbodimentError,
    GripSensor,
    Joint,
    LidarLayout,
    Part,
    Point,
    Polygon,
)
from tma_ray.embodiments.loading import embodiment_names, load_embodiment

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
