"""The command that writes every figure that results allow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from analysis.baselines.catalogue import Sources, published, read
from analysis.charts.paper.style import Vector, save
from analysis.comparisons.measured import measure
from analysis.figures import Drawing, drawings, published_drawings
from analysis.looks import shown_together
from tma_ray.part_names import nearest


@dataclass(frozen=True)
class WrittenFigures:
    """What `write_figures` made.

    Attributes:
        files: vector and PNG files, and GIFs.
        left_out: figures that there is not enough for, and why.
        warnings: what a reader must know before trusting them.
    """

    files: tuple[Path, ...]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]


def write_figures(
    sources: Sources, output: Path, vector: Vector | str = Vector.PDF, only: str = ""
) -> WrittenFigures:
    """Writes the figures of the paper that the results of a root or a baseline allow.

    Args:
        sources: folders, ``s3://`` or ``gs://`` addresses, names of baselines; ``paper-2021`` only alone.
        output: folder to write to, which is made.
        vector: pdf or svg; a PNG lies beside each.
        only: beginning of the names of the figures that are wanted, or of what follows a hyphen in them;
            empty for all.

    Raises:
        ResultsRootError: no results root at that place.
        ValueError: an unknown format, or no figure of such a name.
    """
    kind = Vector(vector)
    baseline = published(sources)
    if baseline is not None:
        return _write(list(published_drawings(baseline.published())), output, kind, only, ())
    frames = read(sources)
    with shown_together(frames.cells["teacher"]):
        return _write(list(drawings(frames, measure(frames))), output, kind, only, frames.notes)


def _write(
    found: list[Drawing], output: Path, kind: Vector, only: str, warnings: tuple[str, ...]
) -> WrittenFigures:
    files: list[Path] = []
    left_out = []
    chosen = [drawing for drawing in found if f"-{only}" in f"-{drawing.name}"]
    if only and not chosen:
        names = [drawing.name for drawing in found]
        hint = nearest(only, names)
        raise ValueError(f"no figure's name begins with {only!r:.60}: {hint}known: {', '.join(names)}")
    output.mkdir(parents=True, exist_ok=True)
    for drawing in chosen:
        try:
            figure = drawing.draw()
        except ValueError as error:  # not enough data for this one: said, and the others are drawn
            left_out.append(f"{drawing.name}: {error}")
            continue
        if isinstance(figure, bytes):
            files.append(output / f"{drawing.name}.gif")
            files[-1].write_bytes(figure)
        else:
            files += save(figure, output / drawing.name, kind)
    return WrittenFigures(tuple(files), tuple(left_out), warnings)
