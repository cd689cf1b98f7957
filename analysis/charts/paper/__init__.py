"""Charts for papers, drawn by matplotlib and saved to files."""

from analysis.charts.paper.drawing import animate, draw, figure_of
from analysis.charts.paper.style import Picture, Vector, png, save

__all__ = ["Picture", "Vector", "animate", "draw", "figure_of", "png", "save"]
