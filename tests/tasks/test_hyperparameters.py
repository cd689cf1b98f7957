"""The grammar of names with settings: parsed, typed, and written back canonically."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field, make_dataclass
from datetime import datetime
from enum import Enum, IntEnum, StrEnum
from pathlib import Path
from typing import Any, ClassVar, Literal, NewType, Optional

import numpy as np
import pytest

from tma_ray.components.settings import config_dict, non_defaults, parse_settings
from tma_ray.support.component_names import base_name, join_name, split_name


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


class Plain(Enum):
    FAST = 1
    SLOW = ("a", 2)


class Level(IntEnum):
    LOW = 1
    HIGH = 2


class Word(str, Enum):  # noqa: UP042 - as written before Python 3.11
    ONE = "one"
    TWO = "two"


Metres = NewType("Metres", float)


@dataclass(frozen=True)
class Annotations:
    schedule: Literal["linear", "cosine"] = "linear"
    power: Literal[1, 2, None] = 1
    pair: tuple[int, float] = (1, 0.5)
    bare: tuple = (1, "a")
    bare_list: list = field(default_factory=lambda: [1, 2])
    names: tuple[str, ...] = ("box", "")
    nested: tuple[tuple[int, int], ...] = ((1, 2), (3, 4))
    rate: np.float64 = np.float64(0.1)  # noqa: RUF009 - numpy's scalars are immutable
    small: np.float32 = np.float32(0.1)  # noqa: RUF009 - numpy's scalars are immutable
    count: np.int64 = np.int64(3)  # noqa: RUF009 - numpy's scalars are immutable
    flag: np.bool_ = np.bool_(True)  # noqa: RUF009 - numpy's scalars are immutable
    plain: Plain = Plain.FAST
    level: Level = Level.LOW
    word: Word = Word.ONE
    file: Path = Path("weights/a.npz")
    length: Metres = Metres(1.5)
    weights: dict[str, float] = field(default_factory=lambda: {"a": 1.0})
    chosen: frozenset[str] = frozenset({"b", "a"})
    modes: tuple[Plain, ...] = (Plain.FAST,)
    optional: Optional[Plain] = None  # noqa: UP045


OTHERS: dict[str, Any] = {"schedule": "cosine", "power": None, "pair": (2, 1.0), "bare": (3,)}
OTHERS["bare_list"] = [3]
OTHERS |= {"names": ("max", "b"), "nested": ((5, 6),), "rate": np.float64(0.3), "small": np.float32(0.7)}
OTHERS |= {"count": np.int64(7), "flag": np.bool_(False), "length": 2.5, "file": Path("b=c.npz")}
OTHERS |= {"plain": Plain.SLOW, "level": Level.HIGH, "word": Word.TWO, "optional": Plain.SLOW}
OTHERS |= {"weights": {"b": 2.0, "c": 3.0}, "chosen": frozenset({"c"}), "modes": (Plain.SLOW, Plain.FAST)}


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_annotated_is_read_shown_and_hashed(name: str) -> None:
    assert OTHERS.keys() == Annotations.__dataclass_fields__.keys()
    default = getattr(Annotations(), name)
    for value in (default, OTHERS[name]):
        part = Annotations(**{name: value})
        stored = json.loads(json.dumps(config_dict(part)))
        shown = join_name("part", non_defaults(Annotations, stored))
        assert (shown == "part") is (value is default)
        for given in (
            parse_settings(Annotations, {}, {name: value}),
            parse_settings(Annotations, {}, stored),
            {name: default} | parse_settings(Annotations, split_name(shown)[1]),
        ):
            assert given[name] == value
            assert type(given[name]) is type(value)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("schedule", "cosin", "schedule = 'cosin': did you mean 'cosine'[?] expected one of linear, cosine"),
        ("power", True, "power = True: .*expected one of 1, 2, none"),
        ("pair", [1, 2, 3], r"pair = \[1, 2, 3\]: expected tuple\[int, float\]"),
        ("pair", [1.5, 2], r"pair = 1\.5: expected int"),
        ("rate", float("nan"), "rate = nan: expected"),
        ("plain", "FASTER", "did you mean 'FAST'[?] expected one of FAST, SLOW"),
        ("weights", {"a": "b"}, "weights = 'b': expected finite float"),
    ],
)
def test_other_values_than_annotated_are_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_settings(Annotations, {}, {name: value})


@dataclass
class Unfit:
    when: datetime = datetime(2026, 1, 1)
    limit: float = float("inf")
    given: InitVar[int] = 3


def test_what_json_does_not_have_is_refused_by_name() -> None:
    for name in ("when", "limit"):
        kept = make_dataclass("Kept", [(name, Any, getattr(Unfit, name))])
        refusal = f"Kept: hyper-parameter {name} = .*expected a value that JSON has"
        with pytest.raises(ValueError, match=refusal):
            config_dict(kept())
    with pytest.raises(ValueError, match="Unfit: hyper-parameter given is not a field of the dataclass"):
        config_dict(Unfit())


def parsed(name: str, **given: Any) -> dict[str, Any]:
    return parse_settings(Part, split_name(name)[1], given)


def canonical(name: str, **given: Any) -> str:
    return join_name(base_name(name), non_defaults(Part, parsed(name, **given)))


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


def test_a_plugin_may_be_named_by_its_file_everywhere() -> None:
    assert base_name("part.py:Part") == "part:Part"
    assert split_name("part.py:Part:rate=0.5") == ("part:Part", {"rate": "0.5"})
    assert canonical("part.py:Part:rate=0.5") == canonical("part:Part:rate=0.5")
    assert base_name("weights.py") == "weights.py"


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
