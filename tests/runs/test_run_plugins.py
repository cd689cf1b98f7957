"""Plug-ins where a run is executed: known there, and the ones that it was planned with."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from small_runs import small_spec

from tma_ray.components.registry import PluginImportError, UnknownNameError
from tma_ray.envs import make_environment
from tma_ray.runs import Cell, InlineTeacher, Plugin, RunSpec, Schedule, effective_spec
from tma_ray.runs.inputs import RunInputs, arguments, import_plugins, importing_plugins
from tma_ray.teachers import TEACHERS, make_teacher
from tma_ray.teachers.random import Random

MODULE = """
from tma_ray.runs.inputs import importing_plugins
from tma_ray.teachers import register_teacher
from tma_ray.teachers.random import Random

imported_as_plugin = importing_plugins()

@register_teacher("of_elsewhere")
class OfElsewhere(Random): ...
"""


SETTINGS = """
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Literal

from corridor import Corridor
from tma_ray.teachers.random import Random

class Mode(Enum):
    CALM = 1
    STORM = 2

class Windy(Corridor):
    def __init__(self, mode: Mode = Mode.CALM, pair: tuple[int, float] = (1, 0.5), file: Path = Path("a")):
        self.seen = mode, pair, file

@dataclass
class Choosy(Random):
    mode: Mode = Mode.CALM
    pair: tuple[int, float] = (1, 0.5)
    file: Path = Path("a")
    schedule: Literal["linear", "cosine"] = "linear"
"""


def test_settings_reach_plugins_as_annotated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that differ from the defaults, and the others, by way of the JSON of a run."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "choosy.py").write_text(SETTINGS)
    for settings in ("", ":mode=STORM:pair=2x0.25:file=b"):
        cell = Cell(f"choosy.py:Windy{settings}", "original", "", "ppo", f"choosy.py:Choosy{settings}")
        planned = effective_spec(cell, 0, Schedule())
        spec = RunSpec.from_dict(json.loads(json.dumps(planned.to_dict())))
        assert spec.environment == f"choosy:Windy{settings and ':file=b:mode=STORM:pair=2x0.25'}"
        choosy = sys.modules["choosy"]
        expected = (
            (choosy.Mode.STORM, (2, 0.25), Path("b")) if settings else (choosy.Mode.CALM, (1, 0.5), Path("a"))
        )
        environment = make_environment(spec.environment, **arguments(spec, "environment"))
        teacher = make_teacher("choosy:Choosy", arguments(spec, "teacher"))
        assert environment.seen == (teacher.mode, teacher.pair, teacher.file) == expected


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that nobody has imported, whose decorator makes a name known."""
    monkeypatch.setattr(TEACHERS, "_decorated", {})
    monkeypatch.setattr(TEACHERS, "_origins", {})
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "elsewhere", raising=False)
    (tmp_path / "elsewhere.py").write_text(MODULE)
    return "elsewhere"


def test_a_state_that_cannot_be_pickled_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = Random.start

    def start_with(teacher: Random, *arguments: object) -> None:
        start(teacher, *arguments)
        teacher.count_, teacher.stream_ = 3, iter(lambda: 0, 1)

    monkeypatch.setattr(Random, "start", start_with)
    teacher = InlineTeacher(small_spec(tmp_path))
    unfit = r"teacher 'random': what it learned cannot be pickled .*: stream_ \("
    with pytest.raises(ValueError, match=unfit):
        teacher.save()


def planned(folder: Path, name: str, plugin: Plugin) -> RunSpec:
    return replace(small_spec(folder), teacher=name, plugins={"teacher": plugin})


def test_names_come_with_the_module(tmp_path: Path, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownNameError):
        TEACHERS.get("of_elsewhere")
    __import__(module)
    source = TEACHERS.plugin("of_elsewhere")
    spec = planned(tmp_path, "of_elsewhere", Plugin(source.module, source.digest))
    assert [each.module for each in RunInputs.of([spec, spec]).sources] == [module]
    for registered in ("_decorated", "_origins"):
        monkeypatch.setattr(TEACHERS, registered, {})
    monkeypatch.delitem(sys.modules, module)  # as in a new process
    again = RunSpec.from_dict(spec.to_dict())
    assert InlineTeacher(again).exchange(None).task is not None
    assert sys.modules[module].imported_as_plugin
    assert not importing_plugins()


@pytest.mark.parametrize(
    ("name", "found"),
    [("odd_teachers:Inquisitive", "this machine has version"), ("random", "one that ships with tma_ray")],
)
def test_another_version_is_refused_by_name(tmp_path: Path, name: str, found: str) -> None:
    spec = planned(tmp_path, name, Plugin("odd_teachers", "another"))
    with pytest.raises(ValueError, match=f"teacher '{name}'.*{found}"):
        InlineTeacher(spec)


def test_a_module_that_ends_its_process_is_an_error_like_others(tmp_path: Path, module: str) -> None:
    (tmp_path / "elsewhere.py").write_text("raise SystemExit(0)")
    with pytest.raises(PluginImportError, match="below 'if __name__"):
        import_plugins(planned(tmp_path, "of_elsewhere", Plugin(module, "")), "teacher")
    assert not importing_plugins()


def test_the_module_that_registers_is_the_plugin_whatever_it_registers(module: str) -> None:
    TEACHERS.register("plain")(Random)
    assert TEACHERS.origin("plain") == __name__
    source = TEACHERS.plugin("plain")
    assert f"{__name__}.py" in source.files
    assert TEACHERS.origin("random") is None
    assert TEACHERS.plugin("random") is None
