"""Every body that ships loads; a body that cannot be built says what is wrong with it."""

from collections.abc import Callable
from pathlib import Path

import pytest

import tma_ray.embodiments
from tma_ray.embodiments import EmbodimentError, embodiment_names, load_embodiment

DATA = Path(tma_ray.embodiments.__file__).parent / "data"


@pytest.mark.parametrize("name", embodiment_names())
def test_every_body_loads_under_its_own_name(name: str) -> None:
    body = load_embodiment(name)
    assert body.name == name
    assert body.parts[body.head].head
    assert body.action_size == len(body.motors) > 0


def test_unknown_name_offers_the_nearest() -> None:
    with pytest.raises(EmbodimentError, match="did you mean 'classic_bipedal'"):
        load_embodiment("clasic_bipedal")


def test_a_body_loads_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(_text().replace('name = "classic_bipedal"', 'name = "mine"'))
    assert load_embodiment(path).name == "mine"
    assert load_embodiment(str(path)).parts == load_embodiment("classic_bipedal").parts


Change = Callable[[str], str]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace('part_b = "lower_2"', 'part_b = "lower_1"'), "connects part 'lower_2'"),
        (lambda text: text.replace("anchor = [0.0, -0.1]", "anchor = [0.0, -0.9]"), "outside part 'hull'"),
        (lambda text: text.replace("density = 5.0", "density = 0.0"), "density 0.0"),
        (lambda text: text.replace('name = "leg_2"', 'name = "leg_1"'), "'leg_1' is used more than once"),
        (lambda text: text.replace("[1.1333333, 0.0333333]", "[0.1, -0.2]"), "part 'hull': vertices.*convex"),
        (lambda text: text.replace('part_b = "lower_2"', 'part_b = "foot"'), "no part 'foot'"),
        (lambda text: text.replace('contact_part = "lower_2"', 'contact_part = "foot"'), "no part 'foot'"),
        (lambda text: text.replace("head = true\n", ""), "exactly one part must have head"),
        (lambda text: text.replace("[-1.6, -0.1]", "[-0.1, -1.6]"), "limits .* must rise"),
        (lambda text: text.replace("motor_torque = 80.0", "motor_torque = 0.0"), "motor_torque"),
        (lambda text: text.replace("friction = 0.1", "frictoin = 0.1"), "unknown field 'frictoin'"),
        (lambda text: text.replace("density = 5.0\n", ""), "'density' is missing"),
        (lambda text: text.replace('body_type = "walker"', 'body_type = "runner"'), "runner"),
        (lambda text: text.replace("[[parts]]", "[parts]"), "mine.toml"),
        (
            lambda text: text.replace('critical = ["stump_tracks"]', "critical = true"),
            "critical must be a list",
        ),
        (
            lambda text: text.replace("torque_cost", "substeps = 0\ntorque_cost"),
            "substeps 0 must be at least 1",
        ),
        (
            lambda text: text.replace("motor_torque = 80.0\nmotor_speed = 6.0\n", ""),
            "without motor .* observed",
        ),
        (lambda text: text.replace("motor_torque = 80.0\n", ""), "motor_torque 0.0 N m and motor_speed"),
        (
            lambda text: text.replace("anchor = [0.0, -0.1]", "anchor = [0.0, -0.1]\nanchor_b = [0.0, 0.0]"),
            r"anchor \[0.0, 0.0\] lies 0.100 m outside part 'leg_1'",
        ),
    ],
)
def test_bodies_that_cannot_be_built_are_refused(tmp_path: Path, change: Change, message: str) -> None:
    path, text = tmp_path / "mine.toml", _text()
    assert change(text) != text
    path.write_text(change(text))
    with pytest.raises(EmbodimentError, match=message):
        load_embodiment(path)


def test_a_joint_may_lie_outside_its_parts_if_the_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(_text().replace("anchor = [0.0, -0.1]", "anchor = [0.0, -0.9]\noutside_parts = true"))
    assert load_embodiment(path).joints[0].anchor == (0.0, -0.9)


def test_only_the_old_bodies_are_drawn_stretched() -> None:
    stretched = [name for name in embodiment_names() if load_embodiment(name).stretched]
    assert stretched == ["old_classic_bipedal", "old_quadrupedal"]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(EmbodimentError, match=r"nowhere\.toml"):
        load_embodiment(tmp_path / "nowhere.toml")


def _text() -> str:
    return (DATA / "classic_bipedal.toml").read_text()
