"""The kits accept what ships and the examples, and name each promise that is broken."""

from pathlib import Path

import pytest

from tma_ray.conformance import BodyConformance, EnvironmentConformance, StudentConformance

EXAMPLES = Path(__file__).parents[2] / "examples"


class TestSwingUp(EnvironmentConformance):
    environment = "swing_up:SwingUp"


class TestHopper(BodyConformance):
    body = str(EXAMPLES / "hopper.toml")


class TestSpider(BodyConformance):
    body = "spider:pairs_of_legs=3"


class TestHillClimber(StudentConformance):
    student = "hill_climber:HillClimber"


class TestPPO(StudentConformance):
    student = "ppo"
    hyperparameters = {"hidden_units": (8, 8), "steps_per_update": 50, "batch_size": 25, "epochs": 2}


def outcome(kit, test: str) -> str:
    """Return what a kit's test says, empty if it passes."""
    try:
        getattr(kit(), test)()
    except AssertionError as error:
        return str(error) or "failed"
    return ""


@pytest.mark.parametrize(
    ("fault", "test", "message"),
    [
        ("accepts anything", "test_tasks_outside_its_domain_are_refused", "was not refused"),
        ("hides the task", "test_it_builds_every_task_of_its_domain", "info of reset must hold the task"),
        ("global randomness", "test_global_random_numbers_are_left_alone", "use self.np_random"),
        ("global randomness", "test_seed_and_actions_determine_what_it_gives", "gives another episode"),
        ("keeps the task", "test_it_builds_every_task_of_its_domain", "copy it"),
        ("one array", "test_what_it_returned_does_not_change_later", "return a new array each time"),
        ("endless", "test_episodes_end", "truncate it"),
        ("no number", "test_values_are_finite_and_in_their_spaces", "a reward is not finite"),
    ],
)
def test_a_broken_environment_is_told_which_promise(fault: str, test: str, message: str) -> None:
    class Kit(EnvironmentConformance):
        environment = "broken_plugins:BrokenSwingUp"
        options = {"fault": fault}
        longest_episode = 500

    assert message in outcome(Kit, test)


@pytest.mark.parametrize(
    ("fault", "test", "message"),
    [
        ("out of bounds", "test_actions_are_inside_of_the_action_space", "expected float32 inside"),
        ("global randomness", "test_the_same_seed_acts_the_same", "is all randomness its own?"),
        ("forgets its generator", "test_a_loaded_state_goes_on_as_if_nothing_had_been", "leave out?"),
        ("changes when asked", "test_asking_changes_nothing", "not equal"),
    ],
)
def test_a_broken_student_is_told_which_promise(fault: str, test: str, message: str) -> None:
    class Kit(StudentConformance):
        student = "broken_plugins:BrokenClimber"
        hyperparameters = {"fault": fault}

    assert message in outcome(Kit, test)


def test_a_body_that_is_torn_apart_is_noticed(tmp_path: Path) -> None:
    text = (EXAMPLES / "hopper.toml").read_text()
    (tmp_path / "light.toml").write_text(text.replace("density = ", "density = -"))

    class Kit(BodyConformance):
        body = str(tmp_path / "light.toml")

    with pytest.raises((AssertionError, ValueError)):
        Kit().test_its_file_is_read()
