"""Saved policies: they act as the student did, hold no pickles, and damaged or hostile ones are refused."""

import json
import pickle
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from safetensors.numpy import load_file, save_file
from students_support import OURS, SMALL, Drift, small_student, train
from torch import nn

from tma_ray.students import PolicyFileError, Student, load_policy, policy_layers, read_policy, write_policy
from tma_ray.students.layers import acting_layers
from tma_ray.students.sb3.algorithms import as_student

OBSERVATIONS = np.random.default_rng(0).normal(0, 3, (200, 3)).astype(np.float32)
STUDENTS = [*SMALL, *(f"stock:{name}" for name in OURS)]
VARIANTS = ["ppo:activation=tanh:separate_trunks=true", "ppo:averaged_steps=100"]
FILES = {"policy.json", "policy.safetensors"}

_watched: list[str] = []
"""Classes that were unpickled while somebody looked; audit hooks stay for as long as the process."""

sys.addaudithook(lambda event, args: _watched.append(str(args)) if event == "pickle.find_class" else None)


@pytest.fixture
def no_pickles(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return what makes every way to unpickle fail until the end of the test."""

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("something is unpickled")

    def forbid() -> None:
        for name in ("load", "loads", "Unpickler", "_Unpickler"):
            monkeypatch.setattr(pickle, name, forbidden)
        monkeypatch.setattr(torch, "load", forbidden)
        monkeypatch.setattr(np, "load", forbidden)
        _watched.clear()

    return forbid


@cache
def trained(name: str) -> Student:
    """Return a student that no test trains on."""
    student = small_student(name)
    train(student, Drift(), 130)
    return student


@pytest.mark.parametrize("name", [*STUDENTS, *VARIANTS])
def test_a_saved_policy_acts_as_its_student_and_is_loaded_without_pickles(name, tmp_path, no_pickles):
    student = trained(name)
    batches = [OBSERVATIONS, OBSERVATIONS[:7], *(row[None] for row in OBSERVATIONS[:20])]
    expected = [student.act_greedily(batch) for batch in batches]
    for folder in (tmp_path, again := tmp_path / "again"):
        folder.mkdir(exist_ok=True)
        student.save_policy(folder)
    assert {path.name for path in again.iterdir()} == FILES
    assert all((tmp_path / name).read_bytes() == (again / name).read_bytes() for name in FILES)
    state = torch.get_rng_state().tolist()
    no_pickles()
    policy = load_policy(name, tmp_path)
    for batch, actions in zip(batches, expected, strict=True):
        np.testing.assert_array_equal(policy(batch), actions)
    assert not _watched
    assert torch.get_rng_state().tolist() == state
    assert np.ptp(expected[0], axis=0).min() > 1e-3  # it does look at the observations


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_policy_plays_elsewhere_as_its_docstring_says(name: str, tmp_path: Path) -> None:
    student = trained(name)
    student.save_policy(tmp_path)
    settings = json.loads((tmp_path / "policy.json").read_text())
    tensors = load_file(tmp_path / "policy.safetensors")
    values = OBSERVATIONS
    if name == "ppo":
        clip = settings["hyperparameters"]["observation_clip"]
        values = (values - tensors["normaliser.mean"]) / np.sqrt(tensors["normaliser.variance"] + 1e-8)
        values = np.clip(values, -clip, clip)
        assert tensors["normaliser.count"] > 100
    for layer in ("hidden.0", "hidden.1"):
        values = np.maximum(values @ tensors[f"{layer}.weight"].T + tensors[f"{layer}.bias"], 0)
    values = values @ tensors["mean.weight"].T + tensors["mean.bias"]
    low, high = (np.array(settings["action_space"][side]) for side in ("low", "high"))
    actions = np.clip(values, low, high) if name == "ppo" else low + (np.tanh(values) + 1) / 2 * (high - low)
    np.testing.assert_allclose(student.act_greedily(OBSERVATIONS), actions, atol=1e-5)
    assert settings["observation_space"] == {"low": [None] * 3, "high": [None] * 3}


@pytest.mark.parametrize("name", ["ppo", "sac", "TD3"])
def test_other_observations_are_refused(name: str, tmp_path: Path) -> None:
    trained(name).save_policy(tmp_path)
    policy = load_policy(name, tmp_path)
    for shape in ((1, 4), (2, 6), (3, 1)):
        with pytest.raises(ValueError, match="shape"):
            policy(np.zeros(shape, np.float32))


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved")
    for name in ("ppo", "TD3"):
        (folder / name).mkdir()
        small_student(name).save_policy(folder / name)
    return folder


@pytest.fixture
def copy(saved: Path, tmp_path: Path) -> Callable[[str], Path]:
    return lambda name: copytree(saved / name, tmp_path, dirs_exist_ok=True)


def bytes_changed(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    return lambda path: (path.write_bytes(change(path.read_bytes())), None)[1]


def tensors_changed(**changes: Any) -> Callable[[Path], None]:
    """Replace tensors, or take away those that are None."""

    def change(path: Path) -> None:
        tensors = {**load_file(path), **{name.replace("__", "."): value for name, value in changes.items()}}
        save_file({name: value for name, value in tensors.items() if value is not None}, path)

    return change


def bias_changed(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[Path], None]:
    """Change what the header says of a tensor, by what `change` makes of the header."""

    def changed(content: bytes) -> bytes:
        end = 8 + struct.unpack("<Q", content[:8])[0]
        header = json.loads(content[8:end])
        header["mean.bias"].update(change(header))
        text = json.dumps(header).encode()
        return struct.pack("<Q", len(text)) + text + content[end:]

    return bytes_changed(changed)


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("was-here"),)


UNSOUND = "no sound safetensors"
HOSTILE_TENSORS = {
    "absent": (Path.unlink, "does not exist"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "does not exist"),
    "empty": (bytes_changed(lambda _: b""), UNSOUND),
    "truncated": (bytes_changed(lambda content: content[:-10]), UNSOUND),
    "header beyond the file": (bytes_changed(lambda data: struct.pack("<Q", 2**62) + data[8:]), UNSOUND),
    "header too long": (bytes_changed(lambda data: struct.pack("<Q", len(data)) + data[8:]), UNSOUND),
    "data beyond the file": (bias_changed(lambda _: {"data_offsets": [0, 2**40]}), UNSOUND),
    "data that overlaps": (bias_changed(lambda header: header["hidden.0.bias"]), UNSOUND),
    "a type that numpy lacks": (bias_changed(lambda _: {"dtype": "F8_E4M3", "shape": [8]}), UNSOUND),
    "a pickle": (bytes_changed(lambda _: pickle.dumps(Evil())), UNSOUND),
    "no tensors": (lambda path: save_file({}, path), "'hidden.0.weight' is missing"),
    "a tensor is missing": (tensors_changed(mean__bias=None), r"'mean\.bias' is missing"),
    "a path for a name": (tensors_changed(**{"../../x": np.ones(1)}), r"'\.\./\.\./x' does not belong"),
    "another shape": (
        tensors_changed(mean__bias=np.zeros(3, np.float32)),
        r"'mean\.bias' is float32 \(3,\), expected float32 \(2,\)",
    ),
    "another type": (tensors_changed(mean__bias=np.zeros(2)), "expected float32"),
    "no deviation": (tensors_changed(normaliser__variance=None), "'normaliser.variance' is missing"),
}


@pytest.mark.parametrize("case", HOSTILE_TENSORS)
def test_unsound_tensors_are_refused(case: str, copy: Callable[[str], Path]) -> None:
    change, message = HOSTILE_TENSORS[case]
    folder = copy("ppo")
    change(folder / "policy.safetensors")
    with pytest.raises(PolicyFileError, match=message) as refusal:
        load_policy("ppo", folder)
    assert str(refusal.value).startswith(str(folder / "policy.safetensors"))
    assert "copy the whole folder again" in str(refusal.value)
    assert not Path("was-here").exists()


def settings(hyper: dict[str, Any] | None = None, **changes: Any) -> Callable[[Path], None]:
    """Replace members of the JSON object, or take away those that are None; `hyper` updates one."""

    def changed(content: bytes) -> bytes:
        members = json.loads(content)
        members["hyperparameters"].update(hyper or {})
        members |= changes
        return json.dumps({name: value for name, value in members.items() if value is not None}).encode()

    return bytes_changed(changed)


BOUNDS = {"low": [-1.0, -1.0], "high": [1.0, 1.0]}


def network(**options: Any) -> Callable[[Path], None]:
    return settings({"policy_kwargs": options})


HOSTILE_SETTINGS = {
    "absent": ("ppo", Path.unlink, "does not exist"),
    "truncated": ("ppo", bytes_changed(lambda content: content[:-20]), "damaged: Input data was truncated"),
    "a list": ("ppo", bytes_changed(lambda _: b"[1, 2]"), "Expected `object`, got `array`"),
    "no text": ("ppo", bytes_changed(lambda _: b"\xff\xfe\x00"), "damaged: JSON is malformed"),
    "deep": ("ppo", bytes_changed(lambda _: b'{"a":' * 200_000), "damaged: "),
    "a later version": ("ppo", settings(format_version=2), "format_version is 2, this tma_ray reads 1"),
    "no version": ("ppo", settings(format_version=None), "missing required field `format_version`"),
    "true for a version": ("ppo", settings(format_version=True), r"got `bool` - at `\$.format_version`"),
    "another student": ("ppo", settings(student="sac"), "of student 'sac', not of 'ppo'"),
    "no hyper-parameters": (
        "ppo",
        settings(hyperparameters=[1]),
        r"Expected `object`, got `array` - at `\$.hyperparameters`",
    ),
    "no space": ("ppo", settings(action_space=None), "missing required field `action_space`"),
    "a space of nothing": ("ppo", settings(action_space={"low": [], "high": []}), "action_space"),
    "half a space": ("ppo", settings(action_space={"low": [0, 0], "high": [1]}), "action_space"),
    "a space upside down": ("ppo", settings(action_space={"low": [1, 1], "high": [0, 2]}), "action_space"),
    "words for bounds": ("ppo", settings(action_space={**BOUNDS, "low": ["a", "b"]}), "action_space"),
    "bounds too large": ("ppo", settings(action_space={**BOUNDS, "high": [1, 10**99]}), "action_space.high"),
    "a larger space": ("ppo", settings(action_space={"low": [0] * 3, "high": [1] * 3}), "expected float32"),
    "no sizes": ("ppo", settings({"hidden_units": "16"}), "hidden_units = '16'"),
    "sizes below 1": ("ppo", settings({"hidden_units": [16, -8]}), "hidden_units"),
    "sizes beyond memory": ("ppo", settings({"hidden_units": [10**12, 10**12]}), "expected float32"),
    "no clip": ("ppo", settings({"observation_clip": "10"}), "observation_clip = '10'"),
    "an unknown hyper-parameter": ("TD3", settings({"gama": 1}), "did you mean 'gamma'"),
    "networks beyond memory": ("TD3", network(net_arch=[20_000] * 2), "more than 100,000,000 parameters"),
    "a class by its name": ("TD3", network(features_extractor_class="os.system"), "no TD3 can be made"),
    "other networks": ("TD3", network(net_arch=[16, 16]), r"'actor\.mu"),
}


@pytest.mark.parametrize("case", HOSTILE_SETTINGS)
def test_unsound_settings_are_refused(case: str, copy: Callable[[str], Path]) -> None:
    name, change, message = HOSTILE_SETTINGS[case]
    folder = copy(name)
    change(folder / "policy.json")
    with pytest.raises(PolicyFileError, match=message) as refusal:
        load_policy(name, folder)
    assert str(refusal.value).startswith(f"{folder}/policy.")


class OfItsOwn(torch.nn.Module):
    """A features extractor with a buffer that is in no state."""

    def __init__(self, observation_space: spaces.Box) -> None:
        super().__init__()
        self.features_dim = 2 * observation_space.shape[0]
        self.register_buffer("scale", torch.arange(1.0, 4.0), persistent=False)
        self.layer = torch.nn.Linear(3, 3)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return torch.cat([observations, self.layer(observations * self.scale)], dim=1)


def test_an_algorithm_of_ones_own_is_saved_and_loaded(tmp_path: Path) -> None:
    from stable_baselines3 import TD3

    class Featured(TD3):
        """Looks at its critics, too, so that the actor alone is not the policy."""

        def __init__(self, policy: Any, env: Any, *, policy_kwargs: Any = None, **others: Any) -> None:
            kwargs = {**(policy_kwargs or {}), "features_extractor_class": OfItsOwn}
            super().__init__(policy, env, policy_kwargs=kwargs, **others)

        def predict(self, observation: Any, *others: Any, **keywords: Any) -> Any:
            actions, state = super().predict(observation, *others, **keywords)
            with torch.no_grad():
                values = self.critic(torch.from_numpy(observation), torch.from_numpy(actions))[0]
            return (actions * np.sign(values.numpy())).astype(np.float32), state

    own, env = as_student(Featured), Drift()
    values = own.hyperparameters_type(**SMALL["TD3"])
    student = own(env.observation_space, env.action_space, values, np.random.SeedSequence(0))
    student.save_policy(tmp_path)
    np.testing.assert_array_equal(own.load_policy(tmp_path)(OBSERVATIONS), student.act_greedily(OBSERVATIONS))


@dataclass
class Linear:
    """What a student of somebody's own writes and reads."""

    weight: np.ndarray
    gain: float

    def save_policy(self, folder: Path) -> None:
        boxes = spaces.Box(-np.inf, np.inf, (3,)), spaces.Box(-1, 1, (2,))
        write_policy(folder, "linear", *boxes, {"weight": self.weight}, {"gain": self.gain})

    @staticmethod
    def load_policy(folder: Path) -> Callable[[np.ndarray], np.ndarray]:
        stored = read_policy(folder, "linear")
        stored.check({"weight": (stored.action_space.shape + stored.observation_space.shape, "float32")})
        weight = stored.hyperparameters["gain"] * stored.tensors["weight"]
        return lambda observations: stored.action_space.high * np.tanh(observations @ weight.T)


def test_a_student_of_ones_own_needs_a_few_lines(tmp_path: Path) -> None:
    weight = np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32).T  # not in the order of C
    Linear(weight, 0.5).save_policy(tmp_path)
    expected = np.tanh(OBSERVATIONS @ (0.5 * weight).T)
    np.testing.assert_allclose(Linear.load_policy(tmp_path)(OBSERVATIONS), expected, rtol=1e-6)
    Linear(np.zeros((2, 4), np.float32), 0.5).save_policy(tmp_path)
    with pytest.raises(PolicyFileError, match=r"'weight' is float32 \(2, 4\), expected float32 \(2, 3\)"):
        Linear.load_policy(tmp_path)


def test_spaces_survive_their_file(tmp_path: Path) -> None:
    low = np.array([-np.inf, -0.1, 0, 3e38], np.float32)
    box = spaces.Box(low, np.array([np.inf, 0.7, np.inf, 3.4e38], np.float32))
    write_policy(tmp_path, "none", box, spaces.Box(-1, 1, (1,)), {})
    assert read_policy(tmp_path, "none").observation_space == box
    assert not read_policy(tmp_path, "none").tensors


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDENTS)
def test_layers_act_as_the_policy(name: str, tmp_path: Path) -> None:
    trained(name).save_policy(tmp_path)
    layers, policy = policy_layers(name, tmp_path), load_policy(name, tmp_path)
    with torch.no_grad():
        actions = layers(torch.from_numpy(OBSERVATIONS)).numpy()
    assert actions.dtype == np.float32
    np.testing.assert_allclose(actions, policy(OBSERVATIONS), atol=1e-5)
    assert not any(part.requires_grad for part in layers.parameters())
    assert not any(isinstance(layer, nn.Sequential) for layer in layers)


@pytest.mark.slow
def test_state_dependent_exploration_is_squashed_and_bounded_as_in_its_library(tmp_path: Path) -> None:
    from stable_baselines3 import A2C, SAC

    observations = OBSERVATIONS[:50]
    for algorithm, keywords in (
        (A2C, {"use_sde": True, "policy_kwargs": {"squash_output": True, "activation_fn": nn.ELU}}),
        (SAC, {"use_sde": True, "policy_kwargs": {"net_arch": [8], "activation_fn": nn.GELU}}),
    ):
        model = algorithm("MlpPolicy", Drift(), device="cpu", seed=0, **keywords)
        with torch.no_grad():
            actions = acting_layers(model)(torch.from_numpy(observations)).numpy()
        np.testing.assert_allclose(actions, model.predict(observations, deterministic=True)[0], atol=1e-5)


@pytest.mark.slow
def test_a_student_that_does_not_tell_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Student does not define policy_layers"):
        Student.policy_layers(tmp_path)
