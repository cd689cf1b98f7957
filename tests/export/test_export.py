"""Exported policies: what is in the folder is true, plays elsewhere, and appears whole or not at all."""

import hashlib
import re
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import yaml
from small_runs import rows, run, stump_tracks_spec
from torch import nn

from tma_ray import __version__
from tma_ray.cli import main
from tma_ray.embodiments import embodiment_names
from tma_ray.envs import make_environment
from tma_ray.export import Export, export
from tma_ray.export.onnx_file import NotExpressibleError
from tma_ray.results import Table
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.runs.checkpoints import find_policy
from tma_ray.students import load_policy

STUDENTS = ["ppo", "sac"]
FILES = {"policy.json", "policy.safetensors", "policy.onnx", "spec.json"}
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs that have ended and one that has not."""
    folder = tmp_path_factory.mktemp("exported")
    for student in STUDENTS:
        spec = stump_tracks_spec(folder, student, "alp_gmm", steps=400, evaluation_interval=200)
        run(spec, folder / "root")
    run(stump_tracks_spec(folder, "ppo", "random", steps=5_000), folder / "root", stop_after=1)
    return folder / "root"


@pytest.fixture(scope="module")
def exports(root: Path) -> dict[str, Export]:
    folders = {student: root.parent / f"{student}-export" for student in STUDENTS}
    return {name: export(f"{name}_alp", folder, root, "CC-BY-4.0") for name, folder in folders.items()}


def card_of(folder: Path) -> tuple[dict[str, Any], str]:
    _, front, text = (folder / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(front), text


def code_of(text: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


def assert_acts_as_its_policy(student: str, folder: Path, observations: np.ndarray) -> np.ndarray:
    """Compare the ONNX file of an exported policy with the policy; return its actions."""
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    (actions,) = session.run(["actions"], {"observations": observations})
    np.testing.assert_allclose(actions, load_policy(student, folder)(observations), atol=1e-5)
    return actions


def spec_of(root: Path, name: str) -> RunSpec:
    return find_policy(name, root).spec


@pytest.mark.parametrize("student", STUDENTS)
def test_the_onnx_file_acts_as_the_policy(student: str, exports: dict[str, Export]) -> None:
    rng = np.random.default_rng(5)
    for count in (1, 64):
        observations = rng.normal(0, 3, (count, 24)).astype(np.float32)
        actions = assert_acts_as_its_policy(student, exports[student].folder, observations)
        assert (actions.dtype, actions.shape) == (np.float32, (count, 4))
        assert np.abs(actions).max() <= 1
    assert np.ptp(actions, axis=0).min() > 1e-4  # it does look at the observations
    assert exports[student].difference <= 1e-5


@pytest.mark.parametrize("student", STUDENTS)
def test_the_onnx_file_says_what_it_is(student: str, root: Path, exports: dict[str, Export]) -> None:
    model = onnx.load(exports[student].folder / "policy.onnx")
    onnx.checker.check_model(model, full_check=True)
    spec = spec_of(root, f"{student}_alp")
    names = {"run_id": spec.run_id, "environment": "stump_tracks", "embodiment": "classic_bipedal"}
    names |= {"student": spec.student, "teacher": spec.teacher, "seed": "0", "steps": "400"}
    versions = {"physics_version": str(spec.physics_version), "tma_ray_version": __version__}
    assert {each.key: each.value for each in model.metadata_props} == names | versions
    assert b"/" not in b"".join(node.SerializeToString() for node in model.graph.node)  # no paths of files
    ends = ((model.graph.input[0], "observations", 24), (model.graph.output[0], "actions", 4))
    for value, name, size in ends:
        batch, values = value.type.tensor_type.shape.dim
        assert (value.name, batch.dim_param, values.dim_value) == (name, "n", size)


@pytest.mark.parametrize("student", STUDENTS)
def test_the_folder_is_the_saved_policy(student: str, root: Path, exports: dict[str, Export]) -> None:
    folder, spec = exports[student].folder, spec_of(root, f"{student}_alp")
    original = root / "policies" / spec.run_id
    for name in ("policy.json", "policy.safetensors", "spec.json"):
        assert (folder / name).read_bytes() == (original / name).read_bytes()
    assert find_policy(str(folder), "nowhere").spec.run_id == spec.run_id
    assert exports[student].run_id == spec.run_id


@pytest.mark.parametrize("student", STUDENTS)
def test_the_card_says_what_the_tables_say(student: str, root: Path, exports: dict[str, Export]) -> None:
    front, text = card_of(exports[student].folder)
    spec = spec_of(root, f"{student}_alp")
    evaluations = [row for row in rows(root, Table.EVALUATIONS) if row["run_id"] == spec.run_id]
    steps = sorted({row["step"] for row in evaluations})
    assert steps[0] == 0
    assert len(steps) == 3
    for step in steps:
        returns = [row["episodic_return"] for row in evaluations if row["step"] == step]
        mastered = 100 * np.mean([value > spec.mastery_threshold for value in returns])
        assert f"| {step:,} | {mastered:.1f} | {np.mean(returns):.1f} |" in text
    assert f"masters **{mastered:.1f} %** of 3 test tasks" in text
    assert f"mean return over these tasks is\n**{np.mean(returns):.1f}**" in text
    assert "is over 230." in text
    (result,) = front["model-index"][0]["results"]
    metrics = {metric["type"]: metric["value"] for metric in result["metrics"]}
    assert metrics == {"mean_reward": round(np.mean(returns), 2), "mastered": round(mastered, 2)}
    assert front["license"] == "cc-by-4.0"
    assert {"reinforcement-learning", "stump_tracks", student, "alp_gmm", "onnx"} <= set(front["tags"])


def test_the_card_says_how_it_was_trained(root: Path, exports: dict[str, Export]) -> None:
    _, text = card_of(exports["ppo"].folder)
    for line in (
        "| stump_height | 0 | 3 | terrain steps of 0.4667 m |",
        "| obstacle_spacing | 0 | 6 | m |",
        "| expert knowledge | none |",  # at low, ALP-GMM is told nothing that it uses
        "| environment steps | 400 |",
        "| seed | 0 |",
        "| 0 | head | angle | rad | none | none |",
        "| 8 | lower_1 | whether it touches ground or ceiling |  | none | none |",
    ):
        assert line in text
    assert re.search(r"\| 14 to 23 \| lidars \| .* \| 5\.333 m \| 0 \| 1 \|", text)
    assert re.search(r"\| 1 \| joint of leg_1 and lower_1 \| .*80 N m.*6 rad/s \|  \| -1 \| 1 \|", text)
    assert re.search(rf"trained with \|.*tma_ray {__version__}, torch {re.escape(version('torch'))}", text)
    assert f"at most {exports['ppo'].difference:.2g} from those" in text
    assert "&#" not in text


@pytest.mark.parametrize("student", STUDENTS)
def test_the_card_lists_every_other_file(student: str, exports: dict[str, Export]) -> None:
    folder = exports[student].folder
    _, text = card_of(folder)
    listed = dict(re.findall(r"^\| (\S+) \| [\d,]+ \| ([0-9a-f]{64}) \|$", text, re.MULTILINE))
    files = {path.name for path in folder.iterdir()} - {"README.md"}
    assert files == FILES
    assert listed == {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files}


@pytest.mark.parametrize("student", STUDENTS)
def test_the_code_of_the_card_runs(student, exports, monkeypatch):
    _, text = card_of(exports[student].folder)
    ours, theirs = code_of(text)
    monkeypatch.chdir(exports[student].folder)
    names: dict[str, Any] = {}
    exec(ours, names)
    assert names["over"]
    assert names["episodic_return"] < 0 or names["episodic_return"] > 0
    exec(theirs, names)
    np.testing.assert_allclose(names["actions"], names["policy"](names["observations"]), atol=1e-5)
    assert len(theirs.splitlines()) == 6


def test_an_exported_folder_is_exported_alone_without_results(exports, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    again = export(str(exports["sac"].folder), tmp_path / "again", onnx=False)
    front, text = card_of(again.folder)
    assert again.difference is None
    assert {path.name for path in again.folder.iterdir()} == FILES - {"policy.onnx"} | {"README.md"}
    assert front["model-index"][0]["results"] == []
    assert "license" not in front
    assert "its evaluations are not known here" in text
    assert "onnxruntime" not in text
    assert "None was given" in text


def test_a_plug_in_is_exported_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    (tmp_path / "two.csv").write_text("mass,length\n1,1\n0.5,0.4\n")
    values = {
        "buffer_size": 500,
        "learning_starts": 100,
        "train_freq": 50,
        "policy_kwargs": {"net_arch": [8]},
    }
    others = {"student_hyperparameters": values, "test_set": str(tmp_path / "two.csv")}
    cell = Cell("swing_up:SwingUp", embodiment="", student="TD3", **others)
    spec = effective_spec(cell, 0, Schedule(steps=200, evaluation_interval=200))
    run(spec, tmp_path / "root")
    done = export("TD3", tmp_path / "out", tmp_path / "root")
    _, text = card_of(done.folder)
    assert "| 0 to 2 | all | not described by the environment |  | -8 | 8 |" in text
    assert "its episodic return is over -200" in text.replace("\n", " ")
    assert "| plug-in | environment from module swing_up, source" in text
    assert "| mass | 0.2 | 2 | kg |" in text
    observations = np.random.default_rng(0).normal(0, 2, (7, 3)).astype(np.float32)
    assert_acts_as_its_policy("TD3", done.folder, observations)
    monkeypatch.chdir(done.folder)
    for code in code_of(text):
        exec(code, {})


def test_what_cannot_be_exported_is_refused_before_anything_is_written(root, tmp_path, monkeypatch):
    full, file = tmp_path / "full", tmp_path / "file"
    full.mkdir()
    (full / "notes.txt").write_text("mine")
    file.write_text("mine")
    new = tmp_path / "new"
    for output, name, keywords, message in (
        (full, "ppo_alp", {}, "is not empty"),
        (file, "ppo_alp", {}, "is a file"),
        (new, "ppo_random", {}, r"spec\.json is missing; a run saves its policy when it ends"),
        (new, "nobody", {}, "nobody"),
        (new, "ppo_alp", {"licence": "do as you like"}, "SPDX identifier"),
    ):
        with pytest.raises(ValueError, match=message):
            export(name, output, root, **keywords)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ValueError, match=r"pip install 'tma_ray\[onnx\]'"):
        export("ppo_alp", new, root)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "full", "notes.txt"]
    assert export("ppo_alp", new, root, onnx=False).difference is None


def test_a_failure_leaves_nothing(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for inputs, message in ((7, "torch cannot export the policy"), (24, "differ by up to")):
        layers = nn.Sequential(nn.Linear(inputs, 4))
        monkeypatch.setattr("tma_ray.export.exporting.policy_layers", lambda *_, layers=layers: layers)
        with pytest.raises(NotExpressibleError, match=message):
            export("ppo_alp", tmp_path / "out", root)
    assert not list(tmp_path.iterdir())


def test_folders_beside_the_output_stay(root: Path, tmp_path: Path) -> None:
    theirs = tmp_path / ".out-unfinished" / "notes.txt"
    theirs.parent.mkdir()
    theirs.write_text("mine")
    (tmp_path / "place").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "place")
    export("ppo_alp", tmp_path / "out", root, onnx=False)
    assert theirs.read_text() == "mine"
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "place" / "README.md").exists()


@pytest.mark.parametrize("environment", ["stump_tracks", "parkour"])
def test_the_signals_of_every_body_are_as_many_as_its_values(environment: str) -> None:
    for body in embodiment_names():
        made = make_environment(environment, embodiment=body)
        for kind in ("observation", "action"):
            signals = made.get_wrapper_attr(f"{kind}_signals")
            assert sum(signal.size for signal in signals) == getattr(made, f"{kind}_space").shape[0]


def test_signals_are_where_they_say() -> None:
    made = make_environment("parkour", embodiment="climbing_chimpanzee")
    meanings = [f"{each.name}: {each.meaning}" for each in made.observation_signals for _ in range(each.size)]
    wet = meanings.index("head: whether it is under water")
    task = made.task_space.centre
    for level in (0.0, 1.0):
        task[list(made.task_space.names).index("water_level")] = level
        observation, _ = made.reset(seed=0, options={"task": task})
        assert observation[wet] == level
    holds = [index for index, text in enumerate(meanings) if text.endswith("whether it holds something")]
    assert observation[holds].tolist() == [1, 1]  # it starts hanging
    grips = [index for index, each in enumerate(made.action_signals) if each.name.startswith("grip")]
    action = np.zeros(made.action_space.shape, np.float32)
    action[grips] = -1
    assert made.step(action)[0][holds].tolist() == [0, 0]


def test_the_command(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "deep" / "out"
    arguments = ["export", "sac_alp", "--results", str(root), "-o", str(output), "--licence", "MIT"]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert str(output) in said.out
    assert not said.err
    assert card_of(output)[0]["license"] == "mit"
    assert main(arguments) == 2
    assert "not empty" in capsys.readouterr().err
