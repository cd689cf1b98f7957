"""Former names of `analysis.teacher_styles`, which published notebooks import."""

from analysis.teacher_styles import TeacherStyle as Look
from analysis.teacher_styles import teacher_style as look

__all__ = ["Look", "look"]
