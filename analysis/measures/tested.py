"""Measures that teachers are ranked by and tested on, in per cent of the test tasks."""

from __future__ import annotations

from analysis.statistics import Scale

MEASURE = "mastered_percent"
"""The paper's: test tasks mastered at the last evaluation."""

MEASURES = {MEASURE: "mastered %", "last_three": "last three %", "mastered_area": "area %"}
"""Measures by column, and their heads in tables: at the last evaluation, as the mean of the last three, and
on average over training. All are comparable between runs of any budget."""

QUANTITIES = {
    MEASURE: "Mastered test tasks (%)",
    "last_three": "Mastered test tasks, last three evaluations (%)",
    "mastered_area": "Mastered test tasks over training (%)",
}
"""The same as labels of axes."""


def scale_of(measure: str) -> Scale:
    """Returns the scale on which means of a measure are tested.

    The spread of an area grows with its mean, and does not on the arcsine scale; that of single evaluations
    does not grow, so that they are tested in per cent (`docs/statistics.md`).
    """
    return Scale.ARCSINE if measure == "mastered_area" else Scale.PERCENT


def how_tested(measure: str, family: str) -> str:
    """Returns the scale of the tests of a measure and the family of their correction, in a sentence.

    Args:
        measure: column, of `MEASURES`.
        family: tests that are corrected together, in words.
    """
    scale = "on the arcsine scale" if scale_of(measure) is Scale.ARCSINE else "in per cent"
    return (
        f"Tested {scale}; Holm's correction covers {family}, so that a verdict can change when a teacher is "
        f"added."
    )
