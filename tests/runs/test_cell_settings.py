"""Settings of cells: part of the identity, named canonically, refused before anything runs."""

import json
from dataclasses import replace

import pytest

from tma_ray.campaign import Campaign
from tma_ray.envs import make_environment
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.students import STUDENTS, check_hyperparameters
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, hyperparameters_of, make_teacher


def spec_of(cell: Cell) -> RunSpec:
    return effective_spec(cell, 0, Schedule())


def test_the_same_setting_gives_the_same_run_wherever_it_is_written() -> None:
    named = spec_of(Cell(teacher="alp_gmm:fit_every=100", student="sac:learning_rate=3e-4:batch_size=500"))
    values = {"teacher_hyperparameters": {"fit_every": 100}}
    values["student_hyperparameters"] = {"learning_rate": 0.0003}
    given = spec_of(Cell(teacher="alp_gmm", student="sac:batch_size=500", **values))
    assert named.run_id == given.run_id
    assert named.teacher_hyperparameters["fit_every"] == 100
    assert named.student_hyperparameters["learning_rate"] == 3e-4
    record = named.record()
    assert record.teacher == "alp_gmm:fit_every=100"
    assert record.student == "sac:batch_size=500:learning_rate=0.0003"
    assert RunSpec.from_dict(json.loads(record.spec)).run_id == named.run_id


def test_defaults_that_are_written_out_change_nothing() -> None:
    default = spec_of(Cell(teacher="alp_gmm"))
    written = f"alp_gmm:fit_every={default.teacher_hyperparameters['fit_every']}"
    assert spec_of(Cell(teacher=written)).run_id == default.run_id
    low, high = default.task_space.low[0], default.task_space.high[0]
    assert spec_of(Cell(teacher="alp_gmm", space={"stump_height": (low, high)})).run_id == default.run_id


def test_one_body_is_one_run_however_it_is_written() -> None:
    bodies = (
        "spider:pairs_of_legs=3:size=1.2",
        "spider:size=1.20:pairs_of_legs=3.0:steps_survivable_under_water=600",
    )
    specs = [spec_of(Cell(embodiment=body)) for body in (*bodies, "spider", "spider:size=1:pairs_of_legs=2")]
    assert specs[0].run_id == specs[1].run_id
    assert specs[1].embodiment == "spider:pairs_of_legs=3:size=1.2"
    assert specs[2].run_id == specs[3].run_id


def test_every_setting_is_part_of_the_identity() -> None:
    cells = [
        *(Cell(teacher=name) for name in ("random", "alp_gmm", "alp_gmm:fit_every=100")),
        *(Cell(student="ppo"), Cell(student="ppo:gamma=0.9"), Cell(space={"stump_height": (0, 0.3)})),
        Cell("parkour", embodiment="fish"),
        Cell("parkour", embodiment="fish", environment_options={"swinging_creepers": True}),
    ]
    assert len({spec_of(cell).run_id for cell in cells}) == len(cells)


def test_a_space_of_ones_own_is_named_and_taught() -> None:
    spec = spec_of(Cell(space={"stump_height": (0, 0.3), "obstacle_spacing": (3, 6)}))
    assert spec.challenge == "original:obstacle_spacing=3..6:stump_height=0..0.3"
    assert spec.task_space.high.tolist() == pytest.approx([0.3, 6])
    assert spec_of(Cell(challenge=spec.challenge)).run_id == spec.run_id
    assert spec.test_set.name == spec_of(Cell()).test_set.name
    row = Campaign("own", (Cell(challenge=spec.challenge),), (0,)).plan().cell_rows[0]
    assert row["challenge"] == spec.challenge


def test_an_easy_task_outside_of_the_space_is_not_told() -> None:
    cell = Cell(teacher="spdl", expert_knowledge=KnowledgeLevel.HIGH, space={"obstacle_spacing": (0, 5)})
    with pytest.raises(ValueError, match="no easy task within its task space"):
        spec_of(cell)
    assert spec_of(replace(cell, expert_knowledge=KnowledgeLevel.LOW)).easy_task is None


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (Cell(teacher="alp_gmm:fit_evry=3"), "teacher 'alp_gmm': unknown .*did you mean 'fit_every'"),
        (Cell(teacher="alp_gmm:fit_every=many"), "fit_every = 'many': expected int"),
        (Cell(student="sac:learning_rate=-1"), "student 'sac': .*expected more than 0"),
        (Cell(student="sac:presets=1"), "unknown hyper-parameter 'presets'"),
        (Cell(space={"stump_hight": (0, 1)}), "did you mean 'stump_height'"),
        (Cell(space={"stump_height": (0, 100)}), "exceeds the valid domain"),
        (Cell(space={"stump_height": (2, 1)}), "is over high"),
        (Cell(challenge="original:stump_height=1"), "expected two numbers"),
        (Cell(environment_options={"weight": 1}), "environment 'stump_tracks': unknown option 'weight'"),
        (Cell("parkour", environment_options={"swinging_creepers": 2}), "expected bool"),
        (Cell("parkour:embodiment=fish"), "use --embodiment"),
        (Cell(teacher="alp_gm"), "did you mean 'alp_gmm'"),
        (Cell(student="ppoo"), "did you mean 'ppo'"),
        (Cell("stump_track"), "did you mean 'stump_tracks'"),
        (Cell(challenge="orignal"), "did you mean 'original'"),
        (Cell(embodiment="classic_bipdal"), "did you mean 'classic_bipedal'"),
        (Cell(teacher_hyperparameters={"explore": 1}), "unknown hyper-parameter .explore."),
        (Cell(student_hyperparameters={"gama": 0.9}), "gamma"),
        (Cell(test_set="nowhere.csv"), "nowhere.csv"),
        (Cell(teacher="not_there:Teacher"), "no module"),
    ],
)
def test_what_cannot_run_is_refused(cell: Cell, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        spec_of(cell)


@pytest.mark.parametrize(
    ("limits", "cell", "message"),
    [
        ({"most_dimensions": 2}, Cell("parkour", embodiment="fish"), "2 dimensions at most, not 8"),
        ({"constant_dimensions": False}, Cell("parkour", embodiment="fish"), "constant dimension"),
    ],
)
def test_a_space_beyond_the_limits_of_a_teacher_is_refused(limits, cell, message, monkeypatch):
    for name, value in limits.items():
        monkeypatch.setattr(TEACHERS.get(cell.teacher), name, value)
    assert spec_of(Cell(teacher=cell.teacher)).task_space.size == 2
    with pytest.raises(ValueError, match=f"teacher 'random': .*{message}"):
        spec_of(cell)


@pytest.mark.parametrize("name", TEACHERS.names())
def test_every_teacher_refuses_numbers_that_are_not_finite(name: str) -> None:
    for key, value in hyperparameters_of(make_teacher(name)).items():
        if isinstance(value, float):
            with pytest.raises(ValueError, match=f"{key} = nan"):
                make_teacher(f"{name}:{key}=nan")


@pytest.mark.parametrize("name", ["ppo", "sac", "stock:ppo", "stock:sac", "TD3"])
def test_students_of_every_kind_take_settings(name: str) -> None:
    assert check_hyperparameters(f"{name}:gamma=0.5").gamma == 0.5
    assert STUDENTS.origin(f"{name}:gamma=0.5") is None


def test_an_environment_is_made_with_the_options_of_its_name() -> None:
    for name, kwargs, swinging in [
        ("parkour", {}, False),
        ("parkour:swinging_creepers=true", {}, True),
        ("parkour:swinging_creepers=true", {"swinging_creepers": False}, False),
    ]:
        environment = make_environment(name, embodiment="fish", **kwargs)
        assert environment.get_wrapper_attr("_swinging_creepers") is swinging
        environment.close()
    with pytest.raises(ValueError, match="did you mean 'swinging_creepers'"):
        make_environment("parkour:swinging_creeper=true")
