"""Holds back what needs engines that know grip sensors. Delete this file once they do."""

from pathlib import Path

import pytest

WITHOUT_ENGINE = {"climbing_chest_chimpanzee", "climbing_chimpanzee"}
"""Bodies that no engine can step yet."""

OF_ALL_BODIES = {"test_another_process_repeats_bit_for_bit", "test_all_repeat_bit_for_bit_in_another_process"}
"""Tests that step every body in one go."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips the tests of physics and environments that step such bodies."""
    for item in items:
        if Path(item.path).parent.name not in ("physics", "envs") or not isinstance(item, pytest.Function):
            continue
        values = item.callspec.params.values() if hasattr(item, "callspec") else ()
        named = any(isinstance(value, str) and value in WITHOUT_ENGINE for value in values)
        if named or item.originalname in OF_ALL_BODIES:
            item.add_marker(pytest.mark.skip(reason="no engine knows grip sensors yet"))
