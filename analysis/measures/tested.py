"""Measures that teachers are ranked by and tested on, in per cent of the test tasks."""

from __future__ import annotations

MEASURE = "mastered_percent"
"""The paper's: test tasks mastered at the end of training."""

MEASURES = {MEASURE: "mastered %", "mastered_area": "area %"}
"""Measures by column, and their heads in tables: at the end, and on average over training."""

QUANTITIES = {
    MEASURE: "Mastered test tasks (%)",
    "mastered_area": "Mastered test tasks over training (%)",
}
"""The same as labels of axes."""
