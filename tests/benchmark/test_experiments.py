"""Experiments, tiers, grids, results and teachers' needs of knowledge are what the paper says."""

import pytest

from tma_ray.benchmark import (
    CASE_STUDIES,
    EXPERIMENTS,
    KNOWLEDGE_REQUIREMENTS,
    MATRICES,
    PPO_GRID,
    SIZES,
    TEACHER_GRIDS,
    TEACHERS,
    Experiment,
    Grid,
    Matrix,
    Requirement,
    Tier,
    challenges_of,
    find_challenge,
    find_experiment,
    paper_results,
    select,
)
from tma_ray.students import default_hyperparameters
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS as REGISTRY
from tma_ray.teachers import (
    canonical_teacher,
    effective_level,
    hyperparameters_of,
    knows_enough,
    make_teacher,
)


def matrices_of(name: str) -> dict[str, Matrix]:
    return {matrix.name: matrix for matrix in find_experiment(name).matrices}


@pytest.mark.parametrize("teacher", TEACHER_GRIDS)
def test_every_point_of_a_grid_makes_a_teacher_and_the_papers_choice_is_the_default(teacher: str) -> None:
    grid = TEACHER_GRIDS[teacher]
    for point in grid.points():
        assert hyperparameters_of(make_teacher(teacher, point)).items() >= point.items()
    assert hyperparameters_of(make_teacher(teacher)).items() >= grid.chosen.items()


def test_the_grids_have_the_papers_sizes() -> None:
    """Seventy points, give or take ten, but for the 81 of Goal-GAN's table."""
    sizes = {teacher: len(grid.points()) for teacher, grid in TEACHER_GRIDS.items()}
    others = dict.fromkeys(("riac", "covar_gmm", "alp_gmm", "setter_solver"), 64)
    assert sizes == {"adr": 72, "goal_gan": 81, "spdl": 72} | others


def test_ppos_choice_is_its_default() -> None:
    defaults = default_hyperparameters("ppo")
    assert {name: defaults[name] for name in PPO_GRID.chosen} == dict(PPO_GRID.chosen)
    for point in PPO_GRID.points():
        assert point["steps_per_update"] % point["batch_size"] == 0


def test_points_begin_with_the_choice_and_thin_out_evenly() -> None:
    grid = Grid({"a": (1, 2, 3), "b": (0, 1)}, chosen={"a": 2, "b": 1})
    points = [(point["a"], point["b"]) for point in grid.points()]
    assert points == [(2, 1), (1, 0), (1, 1), (2, 0), (3, 0), (3, 1)]
    assert grid.points(1) == ({"a": 2, "b": 1},)
    assert grid.points(3) == ({"a": 2, "b": 1}, {"a": 1, "b": 0}, {"a": 2, "b": 0})
    assert grid.points(99) == grid.points()
    with pytest.raises(ValueError, match="not in the grid"):
        Grid({"a": (1,)}, chosen={"a": 2})


def test_the_search_is_at_each_teachers_own_level() -> None:
    search = matrices_of("hyperparameter_search")
    levels = {matrix.teachers[0]: matrix.levels for matrix in search.values()}
    for teacher in ("adr", "goal_gan", "spdl", "setter_solver"):
        assert levels[teacher] == (KnowledgeLevel.HIGH,)
    for teacher in ("riac", "alp_gmm", "covar_gmm"):
        assert levels[teacher] == (KnowledgeLevel.NONE,)
    for matrix in search.values():
        assert (matrix.challenge, matrix.steps, len(matrix.seeds)) == ("original", 7_000_000, 16)
        assert matrix.students == ("sac",)
    (ppo,) = matrices_of("ppo_search").values()
    space = find_challenge(ppo.environment, ppo.challenge).task_space
    assert (ppo.steps, ppo.students, len(ppo.points())) == (10_000_000, ("ppo",), 144)
    assert [(d.low, d.high) for d in space.dimensions] == [(0, 3), (0, 6)]


def test_the_climber_learns_in_an_easy_space_almost_without_water() -> None:
    climbing = CASE_STUDIES[0]
    spaces = challenges_of("parkour")
    easy, dry = spaces["easy"].task_space, spaces[climbing.challenge].task_space
    assert climbing.steps == 10_000_000
    assert (climbing.teachers, climbing.embodiments) == (("random",), ("climbing_chimpanzee",))
    assert len(climbing.seeds) == 16
    for mine, theirs in zip(dry.dimensions, easy.dimensions, strict=True):
        expected = (0, 0.2) if mine.name == "water_level" else (theirs.low, theirs.high)
        assert (mine.low, mine.high) == pytest.approx(expected)
    assert spaces["easy_dry"].test_set_of("climber") == spaces["original"].test_set_of("climber")


def test_names_of_experiments_and_of_their_parts_are_told_apart() -> None:
    assert len({experiment.name for experiment in EXPERIMENTS}) == len(EXPERIMENTS)
    for experiment in EXPERIMENTS:
        for matrices in experiment.stages.values() or [experiment.matrices]:
            assert len({matrix.name for matrix in matrices}) == len(matrices)
    with pytest.raises(ValueError, match="did you mean 'parkour'"):
        find_experiment("parkuor")


def test_teachers_of_experiments_are_in_the_registry_and_the_papers_have_no_others() -> None:
    assert set(TEACHERS) <= set(REGISTRY.names())
    for experiment in EXPERIMENTS:
        named = {teacher for matrix in experiment.matrices for teacher in matrix.teachers}
        assert {canonical_teacher(teacher) for teacher in named} == named
        assert named <= set(TEACHERS) or experiment.name in ("lite_1", "lite_2", "long_1")


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda experiment: experiment.name)
def test_tiers_take_away_and_never_add(experiment: Experiment) -> None:
    for matrix in experiment.matrices:
        smoke, lite, paper = (SIZES[tier].of(matrix) for tier in Tier)
        assert paper == matrix
        decisive = "ppo" if matrix.student_grid else "ppo:preset=decisive"
        assert (lite.students, smoke.students) == ((decisive,), ("ppo",))
        assert lite.seeds == matrix.seeds[:3]
        assert (lite.levels, smoke.levels) == (matrix.levels, matrix.levels[-1:])
        budget = {"stump_tracks": 2_000_000, "parkour": 6_000_000}[matrix.environment]
        assert (lite.steps, smoke.steps) == (budget, 4_000)
        climbs = matrix.embodiments == ("climbing_chimpanzee",)
        assert lite.embodiments == (() if climbs else matrix.embodiments)
        assert smoke.embodiments == paper.embodiments == matrix.embodiments
        assert len(smoke.points()) <= 2
        assert len(lite.points()) <= 12
        assert smoke.points()[0] == matrix.points()[0]


def test_challenges_are_selected_by_either_name() -> None:
    assert [m.name for m in select(MATRICES, ["rugged_difficulty"])] == ["rugged_difficulty"]
    assert [m.name for m in select(MATRICES, ["parkour_climbing"])] == ["parkour_climbing"]
    assert {m.environment for m in select(MATRICES, ["original"])} == {"stump_tracks", "parkour"}
    assert len(select(CASE_STUDIES, ["forgetting_student"])) == 2
    with pytest.raises(ValueError, match=r"'ruged'.*known: original, mostly_unfeasible"):
        select(MATRICES, ["ruged"])


def test_the_papers_results_are_of_the_benchmarks_matrices() -> None:
    results = paper_results()
    assert len(results) == 156
    for result in results:
        place = (result.environment, result.challenge)
        matrices = [m for m in MATRICES if (m.environment, m.challenge) == place]
        assert result.teacher in TEACHERS
        assert result.expert_knowledge in {level for matrix in matrices for level in matrix.levels}
        pooled = [m for m in matrices if set(m.embodiments) <= set(result.embodiments)]
        combinations = ((m, body, each) for m in pooled for body in m.embodiments for each in m.students)
        assert sum(len(matrix.seeds) for matrix, _, _ in combinations) == result.seeds
        assert set(result.students) == {student for matrix in pooled for student in matrix.students}
        assert 0 <= result.mean <= 100


def test_entries_that_cannot_be_right_are_flagged() -> None:
    doubtful = {(r.teacher, r.challenge, r.expert_knowledge.value) for r in paper_results() if r.doubt}
    assert doubtful == {
        ("random", "mostly_unfeasible", "none"),
        ("random", "mostly_trivial", "none"),
        ("setter_solver", "original", "none"),
    }


def test_the_papers_parkour_pools_three_bodies() -> None:
    """Over equal numbers of seeds the mean of all is the mean of the bodies' means, up to rounding."""
    parkour = [result for result in paper_results() if result.environment == "parkour"]
    for teacher in TEACHERS:
        mine = [result for result in parkour if result.teacher == teacher]
        (pooled,) = (result for result in mine if result.seeds == 48)
        assert pooled.mean == pytest.approx(sum(r.mean for r in mine if r.seeds == 16) / 3, abs=0.15)


@pytest.mark.parametrize(("name", "student"), [("lite_1", "ppo"), ("lite_2", "ppo:preset=decisive")])
def test_stages_are_all_of_an_experiment(name: str, student: str) -> None:
    lite = find_experiment(name)
    assert lite.stage(None) == tuple(matrix for stage in lite.stages for matrix in lite.stage(stage))
    assert {(m.students, m.steps) for m in lite.matrices} == {((student,), 2_000_000)}
    for stage in ("core", "seeds"):
        assert {m.levels for m in lite.stage(stage)} == {(KnowledgeLevel.HIGH,)}


def test_long_runs_have_the_papers_budget_and_its_knowledge() -> None:
    long = find_experiment("long_1")
    assert long.stage(None) == tuple(matrix for stage in long.stages for matrix in long.stage(stage))
    expected = ("ppo:preset=decisive", 20_000_000, 2)
    assert {(*each.students, each.steps, each.test_every) for each in long.matrices} == {expected}
    sizes = {
        stage: sum(len(m.teachers) * len(m.embodiments) * len(m.seeds) for m in matrices)
        for stage, matrices in long.stages.items()
    }
    assert sizes == {"parkour": 60 + 4, "stump_tracks": 60, "more_seeds": 200}
    for matrix in long.matrices:
        parkour = matrix.environment == "parkour"
        assert matrix.levels == ((KnowledgeLevel.LOW,) if parkour else (KnowledgeLevel.HIGH,))
    assert {m.challenge for m in long.stage("stump_tracks")} == {"original", "mostly_unfeasible"}


def test_stages_are_found_by_name() -> None:
    lite = find_experiment("lite_1")
    assert sum(len(matrix.embodiments) for matrix in lite.stage("core")) * len(lite.teachers) == 70
    with pytest.raises(ValueError, match=r"no stage 'cor'; known: core, today, levels, parkour, seeds"):
        lite.stage("cor")
    with pytest.raises(ValueError, match=r"parkour has no stage 'core'; known: none"):
        find_experiment("parkour").stage("core")


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
