"""Episodes as files: every format, every kind of policy, and all that is refused."""

import shutil
import sys
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from small_runs import run, small_spec, stump_tracks_spec

from tma_ray.cli import main
from tma_ray.envs import make_environment
from tma_ray.results import Results
from tma_ray.runs.checkpoints import find_policy
from tma_ray.tasks import TaskSpace
from tma_ray.viewing.rendering import EpisodeSettings, parse_task, render, write_frames

SPACE = TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6)})
DOMAIN = TaskSpace.from_bounds({"height": (-3, 9), "spacing": (0, 6)})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The root and the id of a run whose policy normalises what it observes."""
    folder = tmp_path_factory.mktemp("rendered")
    spec = stump_tracks_spec(folder, "ppo", "random")
    run(replace(spec, schedule=replace(spec.schedule, steps=500)), folder / "root")
    (manifest,) = Results.open(folder / "root").runs()
    return folder / "root", manifest.run.run_id


def colours(*levels: int) -> list[np.ndarray]:
    return [np.full((21, 33, 3), level, np.uint8) for level in levels]


def test_a_gif_moves_at_the_pace_of_the_simulation(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    episode = render(EpisodeSettings(environment="parkour", embodiment="fish", steps=9, every=3), path)
    assert episode.steps == 9
    assert path.read_bytes().startswith(b"GIF89a")
    with Image.open(path) as gif:
        assert gif.size == (600, 400)
        assert gif.n_frames == 4
        assert gif.info["duration"] == 60
        frames = []
        for index in range(4):
            gif.seek(index)
            frames.append(np.asarray(gif.convert("RGB")))
    assert all(np.any(before != after) for before, after in pairwise(frames))


def test_a_png_is_the_last_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    render(EpisodeSettings(policy="zero", task="1.5,3", seed=4, steps=7), path)
    environment = make_environment("stump_tracks", embodiment="classic_bipedal", render_mode="rgb_array")
    environment.reset(seed=4, options={"task": [1.5, 3.0]})
    for _ in range(7):
        environment.step(np.zeros(4))
    with Image.open(path) as picture:
        np.testing.assert_array_equal(np.asarray(picture), environment.render())


def test_an_mp4_holds_all_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_frames(path, colours(0, 120, 240), Fraction(25))
    assert path.read_bytes()[4:8] == b"ftyp"
    with av.open(str(path)) as video:
        assert video.streams.video[0].average_rate == 25
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert [frame.shape for frame in frames] == [(20, 32, 3)] * 3
    np.testing.assert_allclose([frame.mean() for frame in frames], [0, 120, 240], atol=3)


def test_the_same_scenario_gives_the_same_file_and_the_seed_another(tmp_path: Path) -> None:
    files = [tmp_path / f"{index}.gif" for index in range(3)]
    for path, seed in zip(files, (1, 1, 2), strict=True):
        climber = {"environment": "parkour", "embodiment": "climbing_chimpanzee"}
        render(EpisodeSettings(**climber, seed=seed, steps=4), path)
    first, same, other = (path.read_bytes() for path in files)
    assert first == same != other


def test_a_run_is_played_in_its_world_by_its_policy(finished: tuple[Path, str], tmp_path: Path) -> None:
    root, run_id = finished
    environment = make_environment("stump_tracks", embodiment="classic_bipedal")
    policy = find_policy(run_id, root).load(environment.observation_space, environment.action_space)
    observation, _ = environment.reset(seed=3, options={"task": [1.5, 3.0]})
    expected = 0.0
    for _ in range(5):
        observation, reward, *_ = environment.step(policy(observation))
        expected += reward
    saved = root / "policies" / run_id
    for name in (run_id, run_id[:5], str(saved), str(saved / "policy.json")):
        episode = render(EpisodeSettings(name, root, seed=3, steps=5), tmp_path / "a.png")
        assert episode.episodic_return == pytest.approx(expected)
        np.testing.assert_array_equal(episode.task, [1.5, 3.0])


def test_a_policy_needs_the_body_it_was_trained_with(finished: tuple[Path, str], tmp_path: Path) -> None:
    root, run_id = finished
    settings = EpisodeSettings(run_id, root, embodiment="spider", steps=1)
    with pytest.raises(ValueError, match=r"trained in stump_tracks with classic_bipedal"):
        render(settings, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_a_damaged_policy_is_named_where_it_lies(finished: tuple[Path, str], tmp_path: Path) -> None:
    root, run_id = finished
    folder = Path(shutil.copytree(root / "policies" / run_id, tmp_path / "downloaded"))
    (folder / "checkpoints").mkdir()
    (folder / "checkpoints" / "policy.json").write_text("[]")  # of the same name, but no part of the policy
    settings = EpisodeSettings(str(folder), steps=1)
    assert render(settings, tmp_path / "a.png").steps == 1
    (folder / "policy.safetensors").write_bytes(b"PK")
    with pytest.raises(ValueError, match=f"^{folder}/policy.safetensors: no sound safetensors file"):
        render(settings, tmp_path / "b.png")
    for content in ("[]", "{", "{}"):
        (folder / "spec.json").write_text(content)
        with pytest.raises(ValueError, match=f"{folder}/spec.json is (damaged|not the spec of a run)"):
            render(settings, tmp_path / "b.png")


def test_runs_that_cannot_be_meant(finished: tuple[Path, str], tmp_path: Path) -> None:
    root, run_id = finished
    for name, place, message in (
        ("nobody", root, f"nobody.*{run_id}"),
        ("nobody", tmp_path, "a results root"),
        (str(tmp_path), root, r"spec\.json is missing"),
    ):
        with pytest.raises(ValueError, match=message):
            find_policy(name, place)


def test_an_environment_that_cannot_be_drawn(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    with pytest.raises(ValueError, match="cannot be drawn"):
        render(EpisodeSettings(environment=spec.environment, embodiment="", steps=1), tmp_path / "a.png")


def test_tasks() -> None:
    rng = np.random.default_rng(0)
    assert parse_task(None, SPACE, DOMAIN, rng).tolist() == [1.5, 3]
    assert parse_task("-1, 6", SPACE, DOMAIN, rng).tolist() == [-1, 6]
    assert parse_task("spacing = 1", SPACE, DOMAIN, rng).tolist() == [1.5, 1]
    drawn = parse_task("random", SPACE, DOMAIN, rng)
    assert SPACE.contains(drawn)
    assert drawn.tolist() != parse_task("random", SPACE, DOMAIN, rng).tolist()


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("1,7", "spacing = 7 is outside"),
        ("width=1", "no dimension 'width'"),
        ("height=nan", "'nan': expected a number"),
        ("height=tall", "'tall': expected a number"),
        ("1", "expected 2 numbers"),
        ("1,2,3", "expected 2 numbers"),
    ],
)
def test_tasks_that_are_none(task: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_task(task, SPACE, DOMAIN, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("-o a.avi", "a.avi"),
        ("-o nowhere/a.gif", "does not exist"),
        ("-o a.gif --task 3,99", "obstacle_spacing = 99"),
        ("-o a.gif --environment parkuor", "parkour"),
        ("-o a.gif --embodiment fsh", "fish"),
        ("-o a.gif --policy sac-random --results missing", "a results root"),
        ("-o a.gif --seed -1", "--seed: '-1': expected a whole number"),
    ],
)
def test_the_command_refuses_before_it_plays(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["render", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_says_how_it_went(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.png"
    assert main(["render", "--embodiment", "spider", "--steps", "3", "-o", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    assert "left after 3 steps" in capsys.readouterr().out


def test_without_pyav_an_mp4_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r"pip install 'tma_ray\[render\]'"):
        render(EpisodeSettings(steps=1), tmp_path / "a.mp4")


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    def broken() -> object:
        yield from colours(1, 2)
        raise RuntimeError("halfway")

    path = tmp_path / "a.gif"
    write_frames(path, colours(7), Fraction(10))
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match="halfway"):
        write_frames(path, broken(), Fraction(10))
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


def test_files_beside_it_stay_and_no_link_is_written_through(tmp_path: Path) -> None:
    beside, elsewhere, path = tmp_path / ".a-unfinished.gif", tmp_path / "elsewhere", tmp_path / "a.gif"
    for theirs in (beside, elsewhere):
        theirs.write_text("mine")
    path.symlink_to(elsewhere)
    write_frames(path, colours(2), Fraction(10))
    assert [theirs.read_text() for theirs in (beside, elsewhere)] == ["mine", "mine"]
    assert Image.open(path).format == "GIF"
    assert len(list(tmp_path.iterdir())) == 3


def test_a_gif_keeps_rare_colours(tmp_path: Path) -> None:
    sky = np.linspace((150, 190, 225), (236, 243, 247), 200)[:, None].repeat(300, axis=1)
    frame = (sky + np.random.default_rng(0).uniform(-3, 3, sky.shape)).round().astype(np.uint8)
    rare = ((210, 40, 36), (246, 208, 52), (34, 120, 44))
    for place, colour in enumerate(rare):
        frame[50, 10 * place : 10 * place + 4] = colour
    write_frames(tmp_path / "a.gif", [frame, frame[::-1]], Fraction(25))
    with Image.open(tmp_path / "a.gif") as gif:
        seen = np.asarray(gif.convert("RGB")).astype(int)
    for place, colour in enumerate(rare):
        np.testing.assert_allclose(seen[50, 10 * place + 1], colour, atol=12)
    assert np.abs(seen - frame).mean() < 3
