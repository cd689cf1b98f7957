"""Every kind of fault, at random instants of a seed; the program `attack` does the same at any length."""

import random
from pathlib import Path

import pytest
from attack import INJECTIONS, SEED, attack, merged
from faults import Check, Site
from kinds import KINDS
from nodes import Nodes

pytestmark = pytest.mark.chaos


@pytest.mark.parametrize("kind", KINDS)
def test_no_row_and_no_byte_is_lost(
    kind: str, tmp_path: Path, environment: dict[str, str], nodes: Nodes, check: Check
) -> None:
    chance, site = random.Random(f"{SEED} {kind}"), Site(tmp_path, environment, nodes.address)
    check(merged(list(attack(kind, INJECTIONS, chance, site, nodes))))
