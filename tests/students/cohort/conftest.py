"""Stacks are updated as on a GPU, all slots at once; the slow tier updates them one by one, too."""

import pytest

from tma_ray.students.cohort import learner


@pytest.fixture(
    params=[
        pytest.param(True, id="together"),
        pytest.param(
            False, id="apart", marks=pytest.mark.slow
        ),  # as cohorts on a processor do in other tests
    ]
)
def _both_ways(request, monkeypatch):
    if request.param:
        monkeypatch.setattr(learner, "batching_is_faster", lambda *_: True)
