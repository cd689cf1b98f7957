"""The paper's table of what teachers need to be told, against what ours make of it."""

from __future__ import annotations

import pytest

from tma_ray.benchmark import KNOWLEDGE_REQUIREMENTS, TEACHERS, Requirement
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS as REGISTRY
from tma_ray.teachers import effective_level, knows_enough

NONE, LOW, HIGH = KnowledgeLevel


def test_every_teacher_of_the_paper_is_there_and_registered() -> None:
    assert set(KNOWLEDGE_REQUIREMENTS) == set(TEACHERS)
    assert set(KNOWLEDGE_REQUIREMENTS) <= set(REGISTRY.names())


@pytest.mark.parametrize("name", KNOWLEDGE_REQUIREMENTS)
def test_a_teacher_runs_without_knowledge_unless_it_requires_the_mastery_range(name: str) -> None:
    required = KNOWLEDGE_REQUIREMENTS[name].mastery_range is Requirement.REQUIRED
    assert knows_enough(REGISTRY.get(name), NONE) is not required
    assert knows_enough(REGISTRY.get(name), LOW)


@pytest.mark.parametrize("name", KNOWLEDGE_REQUIREMENTS)
def test_an_informed_initial_distribution_changes_a_run_unless_it_is_ignored(name: str) -> None:
    ignored = KNOWLEDGE_REQUIREMENTS[name].initial_distribution is Requirement.IGNORED
    assert (effective_level(REGISTRY.get(name), name, HIGH) is HIGH) is not ignored


@pytest.mark.parametrize("name", KNOWLEDGE_REQUIREMENTS)
def test_the_mastery_range_changes_a_run_only_if_it_is_used(name: str) -> None:
    if knows_enough(REGISTRY.get(name), NONE):
        assert effective_level(REGISTRY.get(name), name, LOW) is NONE
        assert KNOWLEDGE_REQUIREMENTS[name].mastery_range is Requirement.IGNORED
