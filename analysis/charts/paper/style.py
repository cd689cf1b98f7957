"""Style of figures, and saving of figures to files."""

import functools
import io
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from analysis.teacher_styles import INK, MUTED, RULE
from tma_ray.support.validation import check_type

DPI = 150  # resolution of PNG pictures on pages, in dots per inch
PRINT_DPI = 300  # resolution of PNG files of `save`, in dots per inch

STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # bundled with matplotlib
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.color": INK,
    "text.parse_math": False,  # plug-ins may have dollar signs in their names
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "pdf.fonttype": 42,  # TrueType, for searchable text
    "svg.hashsalt": "tma_ray",  # fixed, for reproducible element ids
}

P = ParamSpec("P")

R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to draw in `STYLE`, regardless of the user's matplotlib settings."""

    @functools.wraps(draw)
    def draw_in_style(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(STYLE)
            return draw(*args, **kwargs)

    return draw_in_style


class Vector(StrEnum):
    """Vector format of `save`."""

    PDF = "pdf"
    SVG = "svg"


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file with reproducible bytes."""
    return _file(figure, "png", DPI)


def svg(figure: Figure) -> str:
    """Return a figure as an SVG element with searchable text."""
    text = _file(figure, "svg", DPI, {"svg.fonttype": "none"}).decode()
    return " ".join(text[text.index("<svg") :].split())  # in Markdown, an empty line would end the element


def save(figure: Figure, path: str | Path, vector: Vector = Vector.PDF) -> tuple[Path, Path]:
    """Write a figure as a vector file and a PNG file with reproducible bytes.

    Args:
        figure: figure to write.
        path: path of both files without suffix, whose parent folders are created.
        vector: format of the vector file.

    Returns:
        The vector file and the PNG file.
    """
    check_type("figure", figure, Figure, "a figure of matplotlib's")
    files, layout = [], figure.get_layout_engine()
    try:
        for ending in (vector.value, "png"):
            file = Path(f"{path}.{ending}")  # with_suffix would replace ".5" in "after-0.5"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(_file(figure, ending, PRINT_DPI))
            files.append(file)
            figure.set_layout_engine("none")  # to keep the layout for the second file
    finally:
        if layout is not None:
            figure.set_layout_engine(layout)
    return files[0], files[1]


@styled
def _file(figure: Figure, ending: str, dpi: int, settings: Any = None) -> bytes:
    buffer = io.BytesIO()
    mpl.rcParams.update(settings or {})
    FigureCanvasAgg(figure)
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[ending]
    figure.savefig(buffer, format=ending, dpi=dpi, facecolor="white", metadata=metadata)
    return buffer.getvalue()


class Picture(NamedTuple):
    """PNG picture of a figure on a page, with its title and caption.

    Attributes:
        name: file name without suffix.
        png: content of the PNG file.
        title: title of the figure.
        caption: content and number of seeds.
        width: natural width on the page, in CSS pixels.
    """

    name: str
    png: bytes
    title: str
    caption: str
    width: int

    @classmethod
    def of(cls, name: str, figure: Figure, title: str, caption: str) -> "Picture":
        """Return the picture of a figure."""
        return cls(name, png(figure), title, caption, width=round(figure.get_figwidth() * 100))
