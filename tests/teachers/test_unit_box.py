from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES

from tma_ray.tasks import TaskSpace
from tma_ray.teachers.numerics import UnitBox


def test_only_dimensions_with_width_are_chosen() -> None:
    box = UnitBox(SPACES["with_constants"])
    assert box.size == 2
    np.testing.assert_allclose(box.normalise([[0.25, 10, 5]]), [[0.25, 1.0]])
    tasks = box.denormalise(np.array([[0.5, 0.5], [-1.0, 2.0]]))
    assert tasks.tolist() == [[0.5, 10, 0], [0, 10, 5]]
    assert tasks.dtype == np.float32
    assert box.denormalise(np.array([1.0, 0.0])).tolist() == [1, 10, -5]


def test_a_space_without_width_is_refused() -> None:
    with pytest.raises(ValueError, match="there is nothing to choose"):
        UnitBox(TaskSpace.from_bounds({"fixed": (3, 3)}))
