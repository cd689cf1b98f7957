"""Teachers for use in any training loop; members are imported on first access."""

from typing import TYPE_CHECKING

from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from tma_ray.curriculum.curriculum import Curriculum, teacher_needs
    from tma_ray.curriculum.episodes import TaskEvaluation
    from tma_ray.curriculum.shared import SharedCurriculum

__all__ = ["Curriculum", "SharedCurriculum", "TaskEvaluation", "teacher_needs"]

__getattr__, __dir__ = attach(__name__, __file__)
