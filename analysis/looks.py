"""Former names of objects in `analysis.teacher_styles`, since published notebooks import them."""

from analysis.teacher_styles import TeacherStyle as Look
from analysis.teacher_styles import teacher_style as look

__all__ = ["Look", "look"]
