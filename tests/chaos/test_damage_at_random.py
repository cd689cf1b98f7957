"""A few damaged files and interrupted commands of a seed; the programs do the same at any length."""

import random
from collections import Counter
from pathlib import Path

import pytest
from damage import IN_PLACE, KINDS, damaged
from interrupts import AS_EXPECTED, tries

pytestmark = pytest.mark.chaos


@pytest.mark.filterwarnings("always::tma_ray.results.DamagedFileWarning")
def test_no_command_ends_in_a_traceback_and_other_runs_are_left_alone(tmp_path: Path) -> None:
    found = list(damaged(60, random.Random(3), tmp_path))
    assert Counter(each.kind for each in found).keys() == KINDS.keys() | IN_PLACE.keys()
    assert [problem for each in found for problem in each.problems] == []


def test_ctrl_c_at_any_instant_leaves_no_traceback() -> None:
    found = list(tries(12, random.Random(3)))
    assert {each.verdict for each in found} <= set(AS_EXPECTED), found
