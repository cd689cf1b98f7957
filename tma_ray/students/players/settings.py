"""Settings of a cohort. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass

from tma_ray.commands.arguments import check_fields, check_whole


@dataclass(frozen=True)
class CohortSettings:
    """Settings of the learner of a cohort.

    Attributes:
        device: torch's name of where it learns.
        width: slots of each stack of equal students, which are updated together; part of what a result
            depends on, to rounding.
        compiled: updates are compiled, which takes half a minute and pays on a GPU; a text is the mode of
            the compiler.
        threads: torch's threads on a CPU.
    """

    device: str = "cpu"
    width: int = 48
    compiled: bool | str = False
    threads: int = 1

    def __post_init__(self) -> None:
        check_fields(self)
        check_whole("width", self.width, 1)
        check_whole("threads", self.threads, 1)
