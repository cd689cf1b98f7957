from __future__ import annotations

from pathlib import Path

import pytest

from tma_ray.registry import Registry, UnknownNameError, plugin_digest


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
    with pytest.raises(UnknownNameError, match="no module 'no_such_module'"):
        registry.get("no_such_module:Thing")
    with pytest.raises(UnknownNameError, match="has no 'Decimall'"):
        registry.get("decimal:Decimall")


def test_a_name_is_taken_once(registry: Registry[type]) -> None:
    registry.register("circle")(int)
    with pytest.raises(ValueError, match="already"):
        registry.register("circle")(float)


def test_an_edited_plugin_has_another_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib
    import sys

    module = tmp_path / "my_plugin.py"
    monkeypatch.syspath_prepend(tmp_path)
    digests = set()
    for text in ("class Thing: ...\n", "class Thing:\n    edited = True\n"):
        module.write_text(text)
        sys.modules.pop("my_plugin", None)
        importlib.invalidate_caches()
        digests.add(plugin_digest(importlib.import_module("my_plugin").Thing))
    assert len(digests) == 2
    assert None not in digests
    assert plugin_digest(Registry) is None
