"""Choices of how frames are drawn."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """Settings of an environment's frames.

    Attributes:
        lidars: whether their rays are drawn.
        smooth: whether a frame is scaled down to its size. Who scales it to another size takes it twice as
            wide and high as that, (800, 1200, 3), and rough at its edges.
    """

    lidars: bool = True
    smooth: bool = True
