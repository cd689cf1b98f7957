from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from tma_ray.registry import Registry, UnknownNameError


@pytest.fixture
def registry() -> Registry[type]:
    return Registry("shape", "tma_ray.test_shapes", {"fraction": "fractions:Fraction"})


def test_builtin_decorated_and_module_names_are_found(registry: Registry[type]) -> None:
    @registry.register("circle")
    class Circle: ...

    assert registry.get("circle") is Circle
    assert registry.get("fraction").__name__ == "Fraction"
    assert registry.get("decimal:Decimal").__name__ == "Decimal"
    assert registry.names() == ["circle", "fraction"]


def test_unknown_names_say_the_nearest(registry: Registry[type]) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'fraction'"):
        registry.get("fractoin")
    with pytest.raises(UnknownNameError, match="did you mean 'fraction'"):
        registry.get("FRACTION")
    with pytest.raises(UnknownNameError, match="no module 'no_such_module'"):
        registry.get("no_such_module:Thing")
    with pytest.raises(UnknownNameError, match="has no 'Decimall'"):
        registry.get("decimal:Decimall")


def test_a_name_is_taken_once(registry: Registry[type]) -> None:
    registry.register("circle")(int)
    with pytest.raises(ValueError, match="already"):
        registry.register("circle")(float)


def test_an_edited_plugin_has_another_digest(
    registry: Registry[type], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "my_plugin.py"
    monkeypatch.syspath_prepend(tmp_path)
    digests = set()
    for text in ("class Thing: ...\n", "class Thing:\n    edited = True\n"):
        module.write_text(text)
        sys.modules.pop("my_plugin", None)
        importlib.invalidate_caches()
        digests.add(registry.plugin_digest("my_plugin:Thing"))
    assert len(digests) == 2
    assert None not in digests


def test_what_ships_with_the_package_needs_no_digest_and_no_import() -> None:
    shipped: Registry[type] = Registry("thing", "tma_ray.things", {"gone": "tma_ray.nowhere:Thing"})
    assert shipped.plugin_digest("gone") is None
    assert shipped.plugin_digest("tma_ray.teachers.random:Random") is None
    with pytest.raises(UnknownNameError, match="did you mean 'gone'"):
        shipped.plugin_digest("gon")


def test_an_installed_package_offers_names_through_entry_points(
    registry: Registry[type], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "shapes-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: shapes\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[tma_ray.test_shapes]\nsquare = decimal:Decimal\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert registry.get("square").__name__ == "Decimal"
    assert registry.names() == ["fraction", "square"]
