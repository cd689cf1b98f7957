"""Errors of runs: those by which one counts as lost, and the texts of losses and failures."""

from __future__ import annotations

from ray.exceptions import ActorUnschedulableError, RayActorError, RayTaskError

from tma_ray.commands.texts import visible
from tma_ray.results import StorageError
from tma_ray.students.players import CohortFullError, LearnerLostError

LOSSES = RayActorError, ActorUnschedulableError, StorageError, LearnerLostError, CohortFullError
"""Errors by which a run counts as lost: of its process or its teacher's, of a storage that took nothing for
long, of the learner of its cohort."""


def reason_for_loss(error: Exception) -> str:
    """Returns in one line why a run or a learner was lost, without what Ray adds to the error."""
    lines = str(getattr(error, "cause", None) or error).splitlines()
    return " ".join(line for line in lines if not line.startswith("\t"))


def plain_traceback(error: RayTaskError) -> str:
    """Returns the traceback of an actor without the colours in which Ray paints it, also into files."""
    return visible(str(error))
