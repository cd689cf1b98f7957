"""Fixture that updates all slots at once, as on a GPU; in the slow tier also one by one."""

import pytest

from tma_ray.students.cohort import learner


# "apart" is the default on a CPU, and covered by other tests
@pytest.fixture(params=["together", pytest.param("apart", marks=pytest.mark.slow)])
def _both_ways(request, monkeypatch):
    if request.param == "together":
        monkeypatch.setattr(learner, "batching_is_faster", lambda *_: True)
