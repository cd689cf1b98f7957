"""What was built and committed: the engine, and the page of the documentation."""

import hashlib
import json
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from engine_building import CompilerMissingError, build, kernels_in_c, require_zig
from kernel_translation import REAL, WHOLE, ArrayType, Translation, TranslationError, TupleType
from suite.locked import locked

from tma_ray.playground.page import SCRIPTS, SOURCES, WASM

DOCS = Path(__file__).parents[2] / "docs/playground"
BUILT = json.loads((DOCS / "built.json").read_text())


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def test_the_engine_is_of_the_present_kernels_and_pymunk() -> None:
    advice = "run docs/making/make_playground.py: the engine of the page is of other sources"
    assert digest(kernels_in_c().encode()) == BUILT["sources"]["kernels_sha256"], advice
    assert locked()["pymunk"] == BUILT["sources"]["pymunk"], advice


@pytest.mark.parametrize(("name", "file"), [("engine", WASM), ("page", DOCS / "index.html")])
def test_size_and_hash_of_what_is_committed_are_told(name: str, file: Path) -> None:
    content = file.read_bytes()
    assert (len(content), digest(content)) == (BUILT[name]["bytes"], BUILT[name]["sha256"])


def test_the_page_is_of_the_present_markup_style_and_scripts() -> None:
    text = (DOCS / "index.html").read_text(encoding="utf-8")
    stale = [name for name in (*SCRIPTS, "style.css") if (SOURCES / name).read_text("utf-8") not in text]
    assert not stale, "run docs/making/make_playground.py: the page is of other sources"


@pytest.mark.slow
def test_the_engine_is_rebuilt_byte_for_byte() -> None:
    try:
        require_zig()
        content = build()
    except (CompilerMissingError, subprocess.CalledProcessError) as error:
        pytest.skip(f"the compiler or Chipmunk's sources are not here: {error}")
    assert content == WASM.read_bytes()


class Pair(NamedTuple):
    values: np.ndarray
    count: int


def several(pair: Pair, limit: float) -> tuple[float, int]:
    total, at = 0.0, 0
    while at < pair.count and not total > limit:
        total += pair.values[at] / 2 if at % 2 == 0 else max(pair.values[at], 1.0)
        at += 1
    return total, at


def test_a_translation_follows_types() -> None:
    translation = Translation({})
    translation.export("several", several, Pair(np.zeros(2), 2), 0.5)
    pair = TupleType((ArrayType(REAL, 1), WHOLE), ("values", "count"))
    assert translation.function(several, (pair, REAL))[1] == TupleType((REAL, WHOLE))
    assert "max_double(" in translation.functions[0]
    assert 'export_name("several")' in translation.text()


def unknown(values: np.ndarray) -> float:
    return np.linalg.norm(values)  # type: ignore[no-any-return]


def test_what_has_no_counterpart_is_named() -> None:
    with pytest.raises(TranslationError, match=r"unknown: .*np\.linalg"):
        Translation({}).function(unknown, (ArrayType(REAL, 1),))
