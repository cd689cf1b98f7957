"""Stacks are updated as on a GPU, all slots at once, and as on a processor, one after the other."""

import pytest

from tma_ray.students.cohort import learner


@pytest.fixture(params=[True, False], ids=["together", "apart"])
def _both_ways(request, monkeypatch):
    if request.param:
        monkeypatch.setattr(learner, "pays_together", lambda _: True)
