"""Former names of objects in `analysis.teacher_styles`, kept for published notebooks."""

from analysis.teacher_styles import TeacherStyle as Look
from analysis.teacher_styles import teacher_style as look

__all__ = ["Look", "look"]
