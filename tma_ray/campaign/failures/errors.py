"""Errors of runs: those by which one counts as lost, and the text of those by which it has failed."""

from __future__ import annotations

from ray.exceptions import ActorUnschedulableError, RayActorError, RayTaskError

from tma_ray.commands.texts import visible
from tma_ray.results import StorageError
from tma_ray.students.players import CohortFullError, LearnerLostError

LOSSES = RayActorError, ActorUnschedulableError, StorageError, LearnerLostError, CohortFullError
"""Errors by which a run counts as lost: of its process or its teacher's, of a storage that took nothing for
long, of the learner of its cohort."""


def plain_traceback(error: RayTaskError) -> str:
    """Returns the traceback of an actor without the colours in which Ray paints it, also into files."""
    return visible(str(error))
