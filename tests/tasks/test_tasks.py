from pathlib import Path

import numpy as np
import pytest

from tma_ray.tasks import KnowledgeLevel, ShuffledSpace, TaskSpace, TestSet, check_task, expert_knowledge

SPACE = TaskSpace.from_bounds({"height": (-3, 3), "fixed": (10, 10), "spacing": (0, 6)}, {"spacing": "m"})


def test_samples_fill_the_box_and_keep_constants() -> None:
    tasks = SPACE.sample(np.random.default_rng(0), 5000)
    assert tasks.shape == (5000, 3)
    assert tasks.dtype == np.float32
    assert SPACE.contains(tasks)
    np.testing.assert_allclose(tasks.mean(0), [0, 10, 3], atol=0.1)
    np.testing.assert_allclose(tasks.std(0), [6 / 12**0.5, 0, 6 / 12**0.5], atol=0.05)
    assert SPACE.sample(np.random.default_rng(0)).shape == (3,)


def test_normalise_and_denormalise_are_inverse_and_finite() -> None:
    tasks = SPACE.sample(np.random.default_rng(1), 50)
    points = SPACE.normalise(tasks)
    assert np.all(points[:, 1] == 0.5)
    np.testing.assert_allclose(SPACE.denormalise(points), tasks, atol=1e-6)


def test_contains_and_clip_at_the_edges() -> None:
    assert SPACE.contains([3, 10, 6])
    assert not SPACE.contains([3.001, 10, 6])
    assert not SPACE.contains([np.nan, 10, 6])
    np.testing.assert_array_equal(SPACE.clip([9, 0, -1]), np.array([3, 10, 0], np.float32))


def test_a_task_outside_the_valid_domain_is_named() -> None:
    np.testing.assert_array_equal(check_task([1, 10, 2], SPACE), np.array([1, 10, 2], np.float32))
    with pytest.raises(ValueError, match=r"spacing = 7 is outside its valid domain \[0, 6\]"):
        check_task([1, 10, 7], SPACE)
    with pytest.raises(ValueError, match="height = nan"):
        check_task([np.nan, 10, 7], SPACE)
    with pytest.raises(ValueError, match="shape"):
        check_task([[1, 10, 7]], SPACE)


def test_knowledge_follows_the_paper() -> None:
    levels = {
        level: expert_knowledge(level, SPACE, np.random.default_rng(3), easy_task=[0, 10, 6])
        for level in KnowledgeLevel
    }
    assert [levels[level].mastery_threshold for level in KnowledgeLevel] == [None, 230, 230]
    np.testing.assert_array_equal(levels[KnowledgeLevel.HIGH].initial.mean, [0, 10, 6])
    means = (levels[level].initial.mean for level in (KnowledgeLevel.NONE, KnowledgeLevel.LOW))
    np.testing.assert_array_equal(*means)
    for knowledge in levels.values():
        np.testing.assert_allclose(np.sqrt(knowledge.initial.variance), [0.6, 1e-3, 0.6])
        np.testing.assert_allclose(np.sqrt(knowledge.target.variance), [1.5, 1e-3, 1.5])
        np.testing.assert_array_equal(knowledge.target.mean, [0, 10, 3])
    drawn = levels[KnowledgeLevel.HIGH].initial.sample(SPACE, np.random.default_rng(0), 500)
    assert SPACE.contains(drawn)


def test_an_expert_of_a_shuffled_space_tells_where_the_easy_task_went() -> None:
    landscape = ShuffledSpace(SPACE, np.array([[2, 3, 0, 1], [0, 1, 2, 3], [3, 2, 1, 0]]))
    plain, shuffled = (
        expert_knowledge(KnowledgeLevel.HIGH, SPACE, np.random.default_rng(3), [-3, 10, 6], landscape=where)
        for where in (None, landscape)
    )
    np.testing.assert_allclose(shuffled.initial.mean, [0, 10, 1.5], atol=1e-5)
    np.testing.assert_array_equal(shuffled.initial.variance, plain.initial.variance)
    np.testing.assert_array_equal(shuffled.target.mean, plain.target.mean)


def test_a_test_set_survives_its_csv(tmp_path: Path) -> None:
    space = TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6)})
    grid = TestSet.grid("grid", space, 10)
    assert len(grid) == 100
    np.testing.assert_array_equal(grid.tasks[[0, -1]], [[0, 0], [3, 6]])
    (tmp_path / "grid.csv").write_text(grid.to_csv())
    loaded = TestSet.from_csv(tmp_path / "grid.csv")
    np.testing.assert_array_equal(loaded.tasks, grid.tasks)
    assert (loaded.name, loaded.digest) == (grid.name, grid.digest)
    assert repr(loaded) == f"TestSet('grid', height, spacing: 100 tasks, {grid.digest})"
    grid.check(space)
    with pytest.raises(ValueError, match="task 90"):
        grid.check(space.with_bounds("height", 0, 2.9))


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffheight,spacing\r\n1,2\r\n,\r\n",
        "height, spacing\n1, 2\n",
        "\ufeff height , spacing \n 1 ,2\n\n",
    ],
    ids=["Excel", "blanks after commas", "blanks around all"],
)
def test_a_test_set_that_another_program_wrote_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.csv").write_text(text, encoding="utf-8", newline="")
    loaded = TestSet.from_csv(tmp_path / "mine.csv")
    expected = TestSet("mine", ("height", "spacing"), np.array([[1, 2]], dtype=np.float32))
    assert (loaded.dimensions, loaded.digest) == (expected.dimensions, expected.digest)
    loaded.check(TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6)}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("height,spacing\n1,x\n", "line 2"),
        ("height,spacing\n1\n", "expected 2"),
        ("height\n", "at least one"),
        ("a\nnan\n", "finite"),
    ],
)
def test_a_broken_test_set_names_its_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "broken.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        TestSet.from_csv(tmp_path / "broken.csv")
