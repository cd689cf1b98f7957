"""How figures look: type, lines, and one colour for each teacher wherever it appears."""

from __future__ import annotations

import functools
import hashlib
import io
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tma_ray.benchmark import challenges_of
from tma_ray.hyperparameters import PRESET
from tma_ray.part_names import split_name

DPI = 150
"""Resolution of the PNG files, in dots per inch."""

PRINT_DPI = 300
"""Resolution of the PNG files that `save` writes, in dots per inch."""

ONE_COLUMN, TWO_COLUMNS = 3.3, 6.9
"""Widths of a figure on the page of a paper, in inches."""

INK = "#22262b"
MUTED = "#6a717b"
RULE = "#d9dce1"

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
    """Returns `draw` made to work in `STYLE`, whatever the caller's settings, which stay as they are."""

    @functools.wraps(draw)
    def draw_in_style(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return draw_in_style


class Look(NamedTuple):
    """How one teacher is drawn: colour, marker and dashes, so that colour never carries it alone."""

    colour: str
    marker: str
    dashes: str | tuple[int, tuple[int, ...]]


# Okabe and Ito's colour-blind safe palette, its yellow darkened to be seen on white.
_LOOKS = {
    "random": Look("#4d4d4d", "o", (0, (4, 2))),
    "adr": Look("#009e73", "s", "-"),
    "alpgmm": Look("#0072b2", "D", "-"),
    "covargmm": Look("#e69f00", "^", "-"),
    "goalgan": Look("#d55e00", "v", "-"),
    "riac": Look("#56b4e9", "P", "-"),
    "settersolver": Look("#cc79a7", "X", "-"),
    "spdl": Look("#a89a00", "p", "-"),
}
_LABELS = {
    "random": "Random",
    "adr": "ADR",
    "alpgmm": "ALP-GMM",
    "covargmm": "Covar-GMM",
    "goalgan": "GoalGAN",
    "riac": "RIAC",
    "settersolver": "Setter-Solver",
    "spdl": "SPDL",
}
# Paul Tol's muted palette, for teachers of other authors.
_OTHER_COLOURS = ("#332288", "#882255", "#117733", "#aa4499", "#999933", "#44aa99", "#cc6677")
_OTHER_MARKERS = ("h", "<", ">", "*", "d")
_OTHER_DASHES = ((0, (1, 1)), (0, (6, 2)), (0, (3, 1, 1, 1)))


def look(teacher: str) -> Look:
    """Returns how `teacher` is drawn; for an unknown one it follows from the name alone."""
    known = _LOOKS.get(_key(teacher))
    if known is not None:
        return known
    digest = hashlib.sha256(teacher.encode()).digest()
    return Look(
        _OTHER_COLOURS[digest[0] % len(_OTHER_COLOURS)],
        _OTHER_MARKERS[digest[1] % len(_OTHER_MARKERS)],
        _OTHER_DASHES[digest[2] % len(_OTHER_DASHES)],
    )


def label(teacher: str) -> str:
    """Returns the name of a teacher as the paper prints it, or the plug-in's own, with its settings.

    Examples:
        >>> label("alp_gmm"), label("alp_gmm:fit_every=100"), label("goal_gan:preset=release")
        ('ALP-GMM', 'ALP-GMM (fit_every=100)', 'GoalGAN (release)')
    """
    name, settings = split_name(teacher)
    return with_settings(_LABELS.get(_key(name), name), settings)


def with_settings(name: str, settings: Mapping[str, str]) -> str:
    """Returns `name` with settings in brackets; a preset stands for itself."""
    shown = [value if key == PRESET else f"{key}={value}" for key, value in settings.items()]
    return f"{name} ({', '.join(shown)})" if shown else name


def challenge_title(environment: str, challenge: str, otherwise: str) -> str:
    """Returns the title of a challenge of the benchmark, with its settings; `otherwise` of somebody else's.

    Examples:
        >>> challenge_title("parkour:swinging_creepers=true", "easy", "")
        'Parkour, easy task space (swinging_creepers=true)'
    """
    name, bounds = split_name(challenge)
    known = challenges_of(environment).get(name)
    return with_settings(known.title, split_name(environment)[1] | bounds) if known else otherwise


def short_label(teacher: str, length: int = 18) -> str:
    """Returns `label`, cut to `length` characters where a figure has no room for more."""
    name = label(teacher)
    return name if len(name) <= length else f"{name[: length - 1]}…"


def teacher_order(teacher: str) -> tuple[bool, str]:
    """Sorts teachers: Random first, since the others are read against it, then by name."""
    return (_key(teacher) != "random", label(teacher).lower())


class Vector(StrEnum):
    """Vector formats of `save`."""

    PDF = "pdf"
    SVG = "svg"


def png(figure: Figure) -> bytes:
    """Returns `figure` as a PNG file; the same figure gives the same bytes."""
    return _file(figure, "png", DPI)


def save(figure: Figure, path: str | Path, vector: Vector = Vector.PDF) -> tuple[Path, Path]:
    """Writes `figure` as a vector file and as a PNG file; the same figure gives the same bytes.

    Args:
        figure: what to write.
        path: of both files, without their endings; folders above it are made.
        vector: format of the vector file.

    Returns:
        The vector file and the PNG file.
    """
    files = []
    for ending in (vector.value, "png"):
        # A name such as "after-0.5" has a point of its own: the ending is added to it.
        file = Path(f"{path}.{ending}")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(_file(figure, ending, PRINT_DPI))
        files.append(file)
    return files[0], files[1]


@styled
def _file(figure: Figure, ending: str, dpi: int) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    # Without these entries nothing in the file tells when it was written.
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[ending]
    figure.savefig(buffer, format=ending, dpi=dpi, facecolor="white", metadata=metadata)
    return buffer.getvalue()


def _key(teacher: str) -> str:
    return "".join(character for character in teacher.lower() if character.isalnum())
