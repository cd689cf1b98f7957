"""Files that runs read: part of a run by their content, kept in its root, and there wherever it is played."""

import hashlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_runs import SCHEDULE, STUDENTS, run

from analysis.baselines import release, verify
from tma_ray.export import export
from tma_ray.results import Committer, Results, Store, read_plugin, verify_root
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec, inputs
from tma_ray.runs.inputs import arguments
from tma_ray.runs.spec import InputFile
from tma_ray.terrain.parkour import DEFAULT_WEIGHTS
from tma_ray.viewing.rendering import EpisodeSettings, open_rendered, render

HOPPER = Path(__file__).parents[2] / "examples" / "hopper.toml"


def hopping(file: Path, **changes: object) -> RunSpec:
    cell = Cell(embodiment=str(file), student="ppo", student_hyperparameters=STUDENTS["ppo"])
    return effective_spec(replace(cell, **changes), 0, Schedule(**{**vars(SCHEDULE), "steps": 400}))  # type: ignore[arg-type]


@pytest.fixture
def hopper(tmp_path: Path) -> Path:
    file = tmp_path / "mine" / "hopper.toml"
    file.parent.mkdir()
    shutil.copy(HOPPER, file)
    return file


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Another process, which has read none of the files."""
    monkeypatch.setattr(inputs, "_contents", {})
    inputs._folder.cache_clear()
    yield
    inputs._folder.cache_clear()


def test_an_edited_body_makes_another_run_and_a_moved_one_the_same(hopper: Path, tmp_path: Path) -> None:
    first = hopping(hopper)
    assert first.embodiment == "hopper.toml"
    assert first.inputs["environment.embodiment"].sha256 == hashlib.sha256(hopper.read_bytes()).hexdigest()
    assert str(tmp_path) not in json.dumps(first.to_dict())

    moved = tmp_path / "hopper.toml"
    hopper.rename(moved)
    assert hopping(moved).run_id == first.run_id

    moved.write_text(moved.read_text() + "\n# longer legs are for another day\n")
    edited = hopping(moved)
    assert edited.run_id != first.run_id
    assert edited.entropy != first.entropy


def test_parameters_of_a_body_stay_beside_its_name(hopper: Path) -> None:
    spec = hopping(Path(f"{hopper}:size=1.5"))
    assert spec.embodiment == "hopper.toml:size=1.5"
    assert arguments(spec, "environment")["embodiment"].endswith("/hopper.toml:size=1.5")
    assert spec.run_id != hopping(hopper).run_id


def test_weights_given_as_a_file_are_told_by_content(tmp_path: Path) -> None:
    with np.load(DEFAULT_WEIGHTS) as shipped:
        weights = {name: shipped[name] for name in shipped}
    specs = []
    for place, factor in (("a", 1.0), ("b", 1.0), ("c", 0.5)):
        file = tmp_path / place / "others.npz"
        file.parent.mkdir()
        np.savez(file, **{name: factor * value for name, value in weights.items()})
        options = {"cppn_weights": str(file)}
        specs.append(effective_spec(Cell("parkour", environment_options=options), 0, Schedule()))
    assert specs[0].run_id == specs[1].run_id != specs[2].run_id
    assert specs[0].environment == "parkour:cppn_weights=others.npz"


def test_a_test_set_is_told_by_content(tmp_path: Path) -> None:
    specs = []
    for place, height in (("a", "1"), ("b", "1"), ("c", "2")):
        file = tmp_path / place / "tests.csv"
        file.parent.mkdir()
        file.write_text(f"stump_height,obstacle_spacing\n{height},3\n")
        specs.append(effective_spec(Cell(test_set=str(file)), 0, Schedule()))
    assert specs[0].run_id == specs[1].run_id != specs[2].run_id


def test_a_spec_with_inputs_survives_json(hopper: Path) -> None:
    spec = hopping(hopper)
    again = RunSpec.from_dict(json.loads(json.dumps(spec.to_dict())))
    assert (again.run_id, again.inputs) == (spec.run_id, spec.inputs)


@pytest.mark.parametrize("name", ["../hopper.toml", "", "a/b", "..", "a\\b"])
def test_an_input_cannot_name_a_place(name: str) -> None:
    with pytest.raises(ValueError, match="name of a file"):
        InputFile(name, "0" * 64)


def test_large_files_are_refused(hopper: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "MAX_INPUT_BYTES", 10)
    with pytest.raises(ValueError, match=r"hopper\.toml has 0 MiB"):
        hopping(hopper)


@pytest.fixture
def hopped(hopper: Path, tmp_path: Path) -> RunSpec:
    """A short run with a body and a plug-in of one's own, whose files are gone."""
    tests = tmp_path / "three.csv"
    tests.write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n3,1\n")
    spec = hopping(hopper, teacher="odd_teachers:Inquisitive", test_set=str(tests))
    assert run(spec, tmp_path / "root") == "done"
    hopper.unlink()
    tests.unlink()
    return spec


@pytest.mark.usefixtures("elsewhere")
def test_a_release_plays_without_the_files_it_was_made_with(hopped, tmp_path, monkeypatch):
    released = release(tmp_path / "root", "kept", tmp_path / "released")
    shutil.rmtree(tmp_path / "root")
    assert verify(released).problems == ()
    plugin = read_plugin(Store.open(released), hopped.plugins["teacher"].digest)
    assert "class Inquisitive" in plugin.files["odd_teachers.py"].decode()

    monkeypatch.setattr(inputs, "_contents", {})
    rendered = open_rendered(EpisodeSettings(hopped.run_id, released))
    assert rendered.environment.get_wrapper_attr("embodiment").name == "hopper"
    rendered.environment.close()
    picture = tmp_path / "hopper.png"
    render(EpisodeSettings(hopped.run_id, released, steps=2), picture)
    assert picture.exists()

    exported = export(hopped.run_id, tmp_path / "exported", released, onnx=False)
    shutil.rmtree(released)
    monkeypatch.setattr(inputs, "_contents", {})
    rendered = open_rendered(EpisodeSettings(str(exported.folder)))
    assert rendered.environment.get_wrapper_attr("embodiment").name == "hopper"
    rendered.environment.close()


@pytest.mark.usefixtures("elsewhere")
def test_an_unfinished_run_continues_from_what_its_root_keeps(hopper: Path, tmp_path: Path) -> None:
    spec = hopping(hopper)
    inputs.RunInputs.of([spec]).keep(Store.open(tmp_path / "kept"))
    Committer.open(tmp_path / "root")
    shutil.copytree(tmp_path / "kept" / "inputs", tmp_path / "root" / "inputs")
    hopper.unlink()
    inputs._contents.clear()
    inputs._folder.cache_clear()
    assert run(RunSpec.from_dict(spec.to_dict()), tmp_path / "root") == "done"


@pytest.mark.usefixtures("elsewhere")
def test_without_its_file_a_run_says_what_is_missing(hopper: Path) -> None:
    spec = hopping(hopper)
    inputs._contents.clear()
    inputs._folder.cache_clear()
    with pytest.raises(ValueError, match=r"content of hopper\.toml .* is not here"):
        arguments(spec, "environment")


@pytest.mark.usefixtures("hopped")
def test_damaged_and_missing_inputs_are_named(tmp_path: Path) -> None:
    released = release(tmp_path / "root", "kept", tmp_path / "released")
    results = Results.open(released)
    files = [path for path in results.store.files("inputs") if "plugin" not in path]
    assert len(files) == 1
    (released / files[0]).write_text("another body")
    assert any("its sha256 is not the recorded one" in problem for problem in verify(released).problems)
    assert any("its sha256 is not its name" in str(damage) for damage in verify_root(results.store).damage)
    (released / files[0]).unlink()
    assert any(files[0] in problem and "missing" in problem for problem in verify(released).problems)
    assert any("the run reads it" in str(damage) for damage in verify_root(results.store).damage)
