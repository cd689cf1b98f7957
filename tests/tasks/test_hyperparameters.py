"""The grammar of names with settings: parsed, typed, and written back canonically."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

import pytest

from tma_ray.hyperparameters import differing, parse_settings
from tma_ray.part_names import base_name, join_name, split_name


class Kind(StrEnum):
    SOFT = "soft"
    HARD = "hard"


@dataclass
class Part:
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "release": {"rate": 0.5, "count": 7},
        "wide": {"units": (512, 512)},
    }

    rate: float = 0.1
    count: int = 3
    units: tuple[int, ...] = (400, 300)
    clip: float | None = 0.2
    kind: Kind = Kind.SOFT
    shuffle: bool = False
    file: str | None = None
    anything: Any = 1


def parsed(name: str, **given: Any) -> dict[str, Any]:
    return parse_settings(Part, split_name(name)[1], given)


def canonical(name: str, **given: Any) -> str:
    return join_name(base_name(name), differing(Part, parsed(name, **given)))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("rate=3e-4", 3e-4),
        ("rate=2", 2.0),
        ("count=1e6", 1_000_000),
        ("count=1_000", 1000),
        ("units=64x64", (64, 64)),
        ("units=64", (64,)),
        ("clip=none", None),
        ("clip=0.3", 0.3),
        ("kind=hard", Kind.HARD),
        ("shuffle=true", True),
        ("shuffle=False", False),
        ("file=weights/mine.npz", "weights/mine.npz"),
        ("file=none", None),
        ("anything=0.5", 0.5),
        ("anything=true", True),
        ("anything=words", "words"),
    ],
)
def test_text_is_read_as_the_type_that_is_declared(text: str, value: object) -> None:
    (read,) = parsed(f"part:{text}").values()
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rat=1", "unknown hyper-parameter 'rat': did you mean 'rate'"),
        ("rate=fast", "rate = 'fast': expected finite float"),
        ("rate=nan", "rate = nan: expected finite float"),
        ("count=2.5", r"count = 2\.5: expected int"),
        ("units=64xmany", "units = 'many': expected int"),
        ("clip=wide", "clip = 'wide': expected finite float or none"),
        ("kind=sofd", "did you mean 'soft'"),
        ("shuffle=2", "shuffle = '2': expected bool"),
        ("preset=relaese", "unknown preset 'relaese': did you mean 'release'"),
        ("rate=1:rate=2", "rate is given 2 times"),
    ],
)
def test_what_is_wrong_is_named_with_what_was_expected(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parsed(f"part:{text}")


def test_a_value_may_be_repeated_but_not_contradicted() -> None:
    assert parsed("part:rate=0.3", rate=0.3) == {"rate": 0.3}
    with pytest.raises(ValueError, match=r"rate is given as 0\.3 and as 0\.4"):
        parsed("part:rate=0.3", rate=0.4)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("module:Part", "module:Part"),
        ("module:Part:rate=0.1:count=3", "module:Part"),
        ("module:Part:units=64x64:rate=3e-4", "module:Part:rate=0.0003:units=64x64"),
        ("part:rate=1.0", "part:rate=1"),
        ("part:shuffle=True:clip=None", "part:clip=none:shuffle=true"),
        ("part:preset=release", "part:preset=release"),
        ("part:rate=0.5:count=7", "part:preset=release"),
        ("part:rate=0.2:preset=release", "part:preset=release:rate=0.2"),
        ("part:preset=release:kind=hard", "part:kind=hard:preset=release"),
        ("part:preset=release:count=7", "part:preset=release"),
    ],
)
def test_equal_parts_have_equal_names(name: str, expected: str) -> None:
    assert canonical(name) == expected
    assert canonical(expected) == expected
    complete = {field: getattr(Part(), field) for field in Part.__dataclass_fields__}
    assert complete | parsed(expected) == complete | parsed(name)


def test_explicit_values_take_precedence_over_a_preset() -> None:
    assert parsed("part:preset=release:rate=0.2") == {"rate": 0.2, "count": 7}


@pytest.mark.parametrize("file", ["C:/weights.npz", "a=b,c", "100%", "50%3A", ""])
def test_any_text_comes_back_from_a_name(file: str) -> None:
    name = join_name("part", {"file": file})
    assert "," not in name
    assert parsed(name) == {"file": file}


def test_constructors_of_other_kinds_are_read_by_their_signature() -> None:
    def make(path: str, /, embodiment: str = "a", *, swing: bool = False) -> None: ...

    assert parse_settings(make, {"swing": "true"}, kind="option") == {"swing": True}
    with pytest.raises(ValueError, match="unknown option 'swign': did you mean 'swing'"):
        parse_settings(make, {"swign": "true"}, kind="option")
