"""Figures of the curricula of one comparison, by one run of each teacher."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from analysis.comparisons.examples import in_whose_space, which_runs
from analysis.comparisons.measured import Measured
from analysis.data.curricula import Curriculum, moments
from analysis.data.task_axes import Axis, task_axes
from analysis.figures.curricula.dimensions import dimension_bands
from analysis.figures.picture import Picture

LARGEST = 20
"""Spaces with more varied dimensions are not drawn."""


def curriculum_pictures(mine: Measured, curricula: Mapping[str, Curriculum]) -> Iterator[Picture]:
    """Yields the figures of `curricula_of` over the whole run, dimension by dimension."""
    if not curricula:
        return
    axes = task_axes(mine.cells)
    varied = sum(axis.low < axis.high for axis in axes)
    probed = {teacher: each for teacher, each in curricula.items() if len(each.probes)}
    whole_plane = len(axes) == varied == 2  # which charts show step by step
    if 0 < varied <= LARGEST and not whole_plane and len(moments(probed)) > 1:
        yield _dimensions(probed, axes, which_runs(curricula))


def _dimensions(curricula: Mapping[str, Curriculum], axes: tuple[Axis, ...], which: str) -> Picture:
    caption = (
        f"{which}. Of the tasks probed without exploration: median, middle half and middle 90 %, "
        f"dimension by dimension. Dark lines: bounds of the teacher's box, or two standard deviations "
        f"around its Gaussian; dots: means of several Gaussians, larger for more weight."
    )
    constant = sum(axis.low == axis.high for axis in axes)
    if constant:
        caption += f" {constant} constant dimension{'s are' if constant > 1 else ' is'} left out."
    return Picture.of(
        "curriculum-dimensions",
        dimension_bands(curricula, axes),
        "Curriculum over training, dimension by dimension",
        caption + in_whose_space(curricula),
    )
