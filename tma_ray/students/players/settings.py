"""Settings of a cohort. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CohortSettings:
    """Settings of the learner of a cohort.

    Attributes:
        device: torch's name of where it learns.
        width: slots of each stack of equal students, which are updated together; part of what a result
            depends on, to rounding.
        compiled: updates are compiled, which takes a minute or more and pays on a GPU.
        threads: torch's threads on a CPU.
    """

    device: str = "cpu"
    width: int = 48
    compiled: bool = False
    threads: int = 1
