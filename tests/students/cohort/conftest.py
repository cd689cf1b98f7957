"""LearnerPool are updated as on a GPU, all slots at once; the slow tier updates them one by one, too."""

import pytest

from tma_ray.students.cohort import learner


# apart, as cohorts on a processor do in other tests
@pytest.fixture(params=["together", pytest.param("apart", marks=pytest.mark.slow)])
def _both_ways(request, monkeypatch):
    if request.param == "together":
        monkeypatch.setattr(learner, "batching_is_faster", lambda *_: True)
