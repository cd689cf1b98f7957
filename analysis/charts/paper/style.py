"""Style of figures: type, lines and sizes, and the files that they are saved to."""

import functools
import io
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from analysis.looks import INK, MUTED, RULE
from tma_ray.support.validation import check_type

DPI = 150
"""Resolution of the PNG files, in dots per inch."""

PRINT_DPI = 300
"""Resolution of the PNG files that `save` writes, in dots per inch."""

STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # ships with matplotlib: the same figure on every machine
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
    "text.parse_math": False,  # a dollar sign in a plug-in's name is only a dollar sign
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "pdf.fonttype": 42,  # letters stay letters: readable by search, and by editors
    "svg.hashsalt": "tma_ray",  # otherwise identifiers differ from file to file
}

P = ParamSpec("P")

R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Wrap `draw` so that it uses `STYLE`, and neither uses nor changes the caller's settings of matplotlib.

    A figure is the same for everybody: a user's settings, such as ``text.usetex``, may ask for programs that
    are not installed, or for other letters and lines.
    """

    @functools.wraps(draw)
    def draw_in_style(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(STYLE)
            return draw(*args, **kwargs)

    return draw_in_style


class Vector(StrEnum):
    """Vector formats of `save`."""

    PDF = "pdf"
    SVG = "svg"


def png(figure: Figure) -> bytes:
    """Return `figure` as a PNG file; the same figure gives the same bytes."""
    return _file(figure, "png", DPI)


def svg(figure: Figure) -> str:
    """Return `figure` as an SVG element whose text can be searched and read aloud."""
    text = _file(figure, "svg", DPI, {"svg.fonttype": "none"}).decode()
    return " ".join(text[text.index("<svg") :].split())  # no line is empty, which would end it in Markdown


def save(figure: Figure, path: str | Path, vector: Vector = Vector.PDF) -> tuple[Path, Path]:
    """Write `figure` as a vector file and as a PNG file; the same figure gives the same bytes.

    Args:
        figure: figure to write.
        path: path of both files, without their endings; folders above it are made.
        vector: format of the vector file.

    Returns:
        The vector file and the PNG file.
    """
    check_type("figure", figure, Figure, "a figure of matplotlib's")
    files, layout = [], figure.get_layout_engine()
    try:
        for ending in (vector.value, "png"):
            # A name such as "after-0.5" has a point of its own: the ending is added to it.
            file = Path(f"{path}.{ending}")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(_file(figure, ending, PRINT_DPI))
            files.append(file)
            figure.set_layout_engine("none")  # dozens of panels are laid out once for both files
    finally:
        if layout is not None:
            figure.set_layout_engine(layout)
    return files[0], files[1]


@styled
def _file(figure: Figure, ending: str, dpi: int, settings: Any = None) -> bytes:
    buffer = io.BytesIO()
    mpl.rcParams.update(settings or {})
    FigureCanvasAgg(figure)
    # Without these entries nothing in the file tells when it was written.
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[ending]
    figure.savefig(buffer, format=ending, dpi=dpi, facecolor="white", metadata=metadata)
    return buffer.getvalue()


class Picture(NamedTuple):
    """A figure of the report.

    Attributes:
        name: file name without its ending.
        png: content of the file.
        title: content in a few words.
        caption: content and number of seeds.
        width: its natural width on the page, CSS pixels.
    """

    name: str
    png: bytes
    title: str
    caption: str
    width: int

    @classmethod
    def of(cls, name: str, figure: Figure, title: str, caption: str) -> "Picture":
        """Return `figure` as a picture."""
        return cls(name, png(figure), title, caption, width=round(figure.get_figwidth() * 100))
