"""Reads results: measures, statistics, figures, and a report in one page.

Where to begin::

    import analysis

    frames = analysis.load("results")
    frames.cells, frames.evaluations  # pandas frames
"""

from analysis.frames import Frames, load

__all__ = ["Frames", "load"]
