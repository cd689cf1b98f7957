"""Teachers in anyone's training loop: wrappers of environments, one teacher for many processes, its record.

What is listed here is imported when it is first asked for.
"""

from typing import TYPE_CHECKING

from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from tma_ray.curriculum.curriculum import Curriculum
    from tma_ray.curriculum.evaluation import TaskEvaluation
    from tma_ray.curriculum.needs import teacher_needs
    from tma_ray.curriculum.shared import SharedCurriculum

__all__ = ["Curriculum", "SharedCurriculum", "TaskEvaluation", "teacher_needs"]

__getattr__, __dir__ = attach(__name__, __file__)
