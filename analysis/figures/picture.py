"""A figure as the report shows it."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from analysis.figures.style import png


@dataclass(frozen=True)
class Picture:
    """A figure of the report.

    Attributes:
        name: file name without its ending.
        png: the file.
        title: what it is, in a few words.
        caption: what is shown, of how many seeds.
        width: its natural width on the page, CSS pixels.
    """

    name: str
    png: bytes
    title: str
    caption: str
    width: int

    @classmethod
    def of(cls, name: str, figure: Figure, title: str, caption: str) -> Picture:
        """Returns `figure` as a picture."""
        return cls(name, png(figure), title, caption, width=round(figure.get_figwidth() * 100))

    @property
    def wide(self) -> bool:
        """Whether it needs the full width of the page."""
        return self.width > 600
