"""Bodies of files and their outlines; one that cannot be built says what is wrong with it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tma_ray.embodiments
from tma_ray.embodiments import EmbodimentError, GripSensor, Polygon, embodiment_names, load_embodiment

DATA = Path(tma_ray.embodiments.__file__).parent / "data"
Edited = Callable[[str, str, str], Path]


@pytest.fixture
def edited(tmp_path: Path) -> Edited:
    """Write the file of a body with other text in it; return its place."""

    def edit(body: str, old: str, new: str) -> Path:
        path, text = tmp_path / "mine.toml", (DATA / f"{body}.toml").read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return path

    return edit


def test_a_body_loads_from_a_file(edited: Edited) -> None:
    path = edited("classic_bipedal", 'name = "classic_bipedal"', 'name = "mine"')
    assert load_embodiment(path).name == "mine"
    assert load_embodiment(str(path)).parts == load_embodiment("classic_bipedal").parts


UNFIT = {
    "classic_bipedal": [
        ('part_b = "lower_2"', 'part_b = "lower_1"', "connects part 'lower_2'"),
        ("anchor = [0.0, -0.1]", "anchor = [0.0, -0.9]", "outside part 'hull'"),
        ("density = 5.0", "density = 0.0", "density 0.0"),
        ('name = "leg_2"', 'name = "leg_1"', "'leg_1' is used more than once"),
        ("[1.1333333, 0.0333333]", "[0.1, -0.2]", "part 'hull': vertices.*convex"),
        ('part_b = "lower_2"', 'part_b = "foot"', "no part 'foot'"),
        ('contact_part = "lower_2"', 'contact_part = "foot"', "no part 'foot'"),
        ("head = true\n", "", "exactly one part must have head"),
        ("[-1.6, -0.1]", "[-0.1, -1.6]", "limits .* must rise"),
        ("motor_torque = 80.0", "motor_torque = 0.0", "motor_torque"),
        ("friction = 0.1", "frictoin = 0.1", "unknown field 'frictoin'"),
        ("density = 5.0\n", "", "'density' is missing"),
        ('= "walker"', '= "runner"', "body_type 'runner' must be one of walker, swimmer, climber, amphibian"),
        ("torque_cost", 'lidars = "back"\ntorque_cost', "lidars 'back' must be one of down, up, full"),
        (
            "under_water = 600",
            "under_water = -1",
            "steps_survivable_under_water -1 must be a whole number of time steps, 0 or more",
        ),
        (
            "under_water = 600",
            "outside_water = 2.5",
            "steps_survivable_outside_water 2.5: Expected `int | null`, got `float`",
        ),
        ("[[parts]]", "[parts]", "mine.toml"),
        ('critical = ["stump_tracks"]', "critical = true", "critical True: Expected `array`, got `bool`"),
        ("torque_cost", "substeps = 0\ntorque_cost", "substeps 0 must be at least 1"),
        (
            "torque_cost",
            "substeps = 4\nmotor_share = 0.3\ntorque_cost",
            "motor_share 0.3 must be a whole number of the 4 substeps",
        ),
        (
            "torque_cost",
            "substeps = 4\nmotor_share = 1.5\ntorque_cost",
            "motor_share 1.5 must be a whole number of the 4 substeps",
        ),
        ("motor_torque = 80.0\nmotor_speed = 6.0\n", "", "without motor .* observed"),
        ("motor_torque = 80.0\n", "", "motor_torque 0.0 N m and motor_speed"),
        (
            "anchor = ",
            "anchor_b = [0, 0]\nanchor = ",
            r"anchor \[0.0, 0.0\] lies 0.100 m outside part 'leg_1'",
        ),
        ("torque_cost = ", "torque_cost = 'x' # ", "body: torque_cost 'x': Expected `float`, got `str`"),
        ("spawn_height = ", "spawn_height = nan # ", "spawn_height nan: expected numbers within"),
        ("density = ", "density = 1e300 # ", r"density 1e\+300: expected numbers within"),
        ("position = ", "position = [1.0] # ", r"position \[1.0\]: Expected `array` of length 2, got 1"),
        ("head = ", "head = 1 # ", "head 1: Expected `bool`, got `int`"),
    ],
    "climbing_chimpanzee": [
        ('\npart = "hand_2"', '\npart = "paw"', "grip sensor 'hand_sensor_2': no part 'paw'; the parts are"),
        (
            "position = [0.0, 2.8666667]",
            "position = [0.0, 2.94]",
            r"grip sensor 'hand_sensor_1': position \[0.0, 2.94\] lies 0.073 m outside part 'hand_1'",
        ),
        ("radius = 0.05", "radius = 0.0", "grip sensor 'hand_sensor_1': radius 0.0 m .* over 0"),
        ("radius = 0.05\ndensity = 1.0", "density = -1.0", "'hand_sensor_1': .*density -1.0 kg/m² .* over 0"),
        ('name = "hand_sensor_2"', 'name = "hand_sensor_1"', "'hand_sensor_1' is used more than once"),
        ('name = "hand_sensor_2"', 'name = "hand_2"', "name 'hand_2' is used more than once"),
        ("radius = 0.05", "raduis = 0.05", "grip sensor 'hand_sensor_1': unknown field 'raduis'"),
        ('\npart = "hand_2"\n', "\n", "grip sensor 'hand_sensor_2': field 'part' is missing"),
    ],
    "spider": [
        ("count = 2", "count = 9", "pairs_of_legs 9 must be a whole number from 1 to 8"),
        ("at_most = 8", "", "repeat 'pairs_of_legs'.*at_most"),
        ("{2k}", "{2k-1}", "is used more than once"),
    ],
}
"""Texts of the files of bodies, what replaces them, and what the refusal says."""


@pytest.mark.parametrize(
    ("body", "old", "new", "message"), [(body, *row) for body, rows in UNFIT.items() for row in rows]
)
def test_impossible_bodies_are_refused(edited: Edited, body: str, old: str, new: str, message: str) -> None:
    with pytest.raises(EmbodimentError, match=message):
        load_embodiment(edited(body, old, new))


def test_a_single_joint_in_place_of_sections_is_named(edited: Edited) -> None:
    text = (DATA / "classic_bipedal.toml").read_text()
    joints = text[text.index("[[joints]]") :]
    single = joints[: joints.index("[[", 2)].replace("[[joints]]", "[joints]")
    with pytest.raises(EmbodimentError, match=r"joints .*: expected sections"):
        load_embodiment(edited("classic_bipedal", joints, single))


def test_a_grip_sensor_may_stick_out_of_its_part_by_its_radius(edited: Edited) -> None:
    path = edited("climbing_chimpanzee", "position = [0.0, 2.8666667]", "position = [0.0, 2.93]")
    assert load_embodiment(path).grip_sensors[0].position == (0.0, 2.93)


def test_a_grip_sensor_has_the_mass_and_inertia_of_a_disc() -> None:
    sensor = GripSensor("sensor", "hand", (0.0, 0.0), radius=0.5, density=4.0)
    assert sensor.mass == pytest.approx(np.pi)
    assert sensor.inertia == pytest.approx(np.pi / 8)


def test_a_joint_may_lie_outside_its_parts_if_the_file_says_so(edited: Edited) -> None:
    new = "anchor = [0.0, -0.9]\noutside_parts = true"
    path = edited("classic_bipedal", "anchor = [0.0, -0.1]", new)
    assert load_embodiment(path).joints[0].anchor == (0.0, -0.9)


def test_only_the_old_bodies_are_drawn_stretched() -> None:
    stretched = [name for name in embodiment_names() if load_embodiment(name).stretched]
    assert stretched == ["old_classic_bipedal", "old_quadrupedal"]


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    text = (DATA / "spider.toml").read_text()
    bodies = []
    for encoding in ("utf-8", "utf-8-sig"):
        (tmp_path / encoding).mkdir()
        (tmp_path / encoding / "mine.toml").write_text(text, encoding=encoding)
        bodies.append(load_embodiment(tmp_path / encoding / "mine.toml"))
    assert bodies[0] == bodies[1]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(EmbodimentError, match=r"nowhere\.toml"):
        load_embodiment(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("corners", [3, 4, 5, 8])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (2.5, -1.0)])
def test_regular_polygon_has_the_textbook_area_and_moment(corners: int, centre: tuple[float, float]) -> None:
    radius, angles = 0.7, 2 * np.pi * np.arange(corners) / corners
    points = np.array(centre) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    polygon = Polygon(tuple(map(tuple, points.tolist())))
    area = corners / 2 * radius**2 * np.sin(2 * np.pi / corners)
    assert polygon.area == pytest.approx(area)
    assert polygon.centroid == pytest.approx(centre)
    expected = area * radius**2 / 2 * (1 - 2 / 3 * np.sin(np.pi / corners) ** 2)
    assert polygon.second_moment == pytest.approx(expected)


def test_distance_is_negative_inside_and_positive_outside() -> None:
    polygon = Polygon(((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)))
    assert polygon.distance((1.0, 0.5)) == pytest.approx(-0.5)
    assert polygon.distance((1.0, 1.25)) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (((0.0, 0.0), (1.0, 0.0)), "at least 3"),
        (((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)), "counter-clockwise"),
        (((0.0, 0.0), (2.0, 0.0), (0.5, 0.5), (0.0, 2.0)), "convex"),
        (((1.0, 0.0), (-0.8, 0.6), (0.3, -0.95), (0.3, 0.95), (-0.8, -0.6)), "convex"),  # a star
        (((0.0, 0.0), (1.0, 0.0), (float("nan"), 1.0)), "finite"),
    ],
)
def test_shapes_that_are_no_convex_polygon_are_refused(vertices, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Polygon(vertices)
