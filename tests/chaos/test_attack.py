"""Faults, damaged files and interrupts at random instants of a seed; programs do the same at any length."""

import random
from collections import Counter
from pathlib import Path

import damage
import pytest
from attack import INJECTIONS, SEED, attack, merged
from faults import Site
from interrupts import AS_EXPECTED, tries
from kinds import KINDS

pytestmark = pytest.mark.chaos


@pytest.mark.parametrize("kind", KINDS)
def test_no_row_and_no_byte_is_lost(kind, tmp_path, environment, nodes, check):
    chance, site = random.Random(f"{SEED} {kind}"), Site(tmp_path, environment, nodes.address)
    check(merged(list(attack(kind, INJECTIONS, chance, site, nodes))))


@pytest.mark.filterwarnings("always::tma_ray.results.DamagedFileWarning")
def test_no_command_ends_in_a_traceback_and_other_runs_are_left_alone(tmp_path: Path) -> None:
    found = list(damage.damaged(60, random.Random(3), tmp_path))
    assert Counter(each.kind for each in found).keys() == damage.KINDS.keys() | damage.IN_PLACE.keys()
    assert [problem for each in found for problem in each.problems] == []


def test_ctrl_c_at_any_instant_leaves_no_traceback() -> None:
    found = list(tries(12, random.Random(3)))
    assert {each.verdict for each in found} <= set(AS_EXPECTED), found
