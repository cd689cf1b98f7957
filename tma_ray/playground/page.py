"""The page as one file: markup, style, scripts, the engine, bodies and policies."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import embodiment_names
from tma_ray.playground.compiling import WASM
from tma_ray.playground.contents import bodies, constants, variants, worlds
from tma_ray.playground.policies import policy_record
from tma_ray.runs.saved_policies import SavedPolicy

SOURCES: Final = Path(__file__).parent / "page"

SCRIPTS: Final = ("engine.js", "worlds.js", "drawing.js", "play.js")

RANDOM, ZERO = -2, -1
"""Places of the untrained policies in the page's list, whose end they are."""


@dataclass(frozen=True)
class Start:
    """What the page plays first.

    Attributes:
        environment: name of the environment.
        embodiment: name of the body, with its parameters.
        policies: places in the list of policies, or RANDOM or ZERO.
        task: the task (d,); None for the middle of the space.
        seed: seed of the page's own worlds.
    """

    environment: str = "stump_tracks"
    embodiment: str = "classic_bipedal"
    policies: tuple[int, ...] = (RANDOM,)
    task: tuple[float, ...] | None = None
    seed: int = 0


def page_html(policies: Sequence[dict[str, Any]], start: Start, names: Sequence[str] | None = None) -> str:
    """Return the page as HTML, which needs no other file and no network.

    Args:
        policies: records of policies, as `policy_record` makes them.
        start: world that is played first.
        names: bodies, with parameters; None for every body in its own size and the first one in all sizes.
    """
    own = [*embodiment_names(), start.embodiment, *(policy["embodiment"] for policy in policies)]
    shown = dict.fromkeys([*own, *variants(start.embodiment.partition(":")[0])] if names is None else names)
    data = {
        "wasm": np.frombuffer(WASM.read_bytes(), np.uint8),
        "constants": constants(),
        "bodies": bodies(shown),
        **worlds(),
        "policies": list(policies),
        "start": vars(start),
    }
    text = (SOURCES / "index.html").read_text(encoding="utf-8")
    scripts = "\n".join((SOURCES / name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = (SOURCES / "style.css").read_text(encoding="utf-8")
    text = text.replace("/*STYLE*/", style).replace("/*SCRIPT*/", scripts)
    return text.replace("/*DATA*/", base64.b64encode(_packed(data)).decode())


def _packed(data: dict[str, Any]) -> bytes:
    """Return `data` compressed: the length of a JSON text, the text, and the arrays that it names.

    The first bytes of all numbers of an array come first, then the second ones: they are more alike.
    """
    arrays = bytearray()

    def store(values: NDArray[Any]) -> dict[str, Any]:
        entry = [len(arrays), len(values), values.dtype.itemsize]
        arrays.extend(values.view(np.uint8).reshape(len(values), -1).T.tobytes())
        return {"array": entry}

    text = json.dumps(data, separators=(",", ":"), allow_nan=False, default=store).encode()
    return zlib.compress(len(text).to_bytes(4, "little") + text + arrays, 9)


def policy_page(saved: SavedPolicy, results: str | Path) -> str:
    """Return the page with one policy, in its environment and body.

    Raises:
        ValueError: the page cannot show the policy; see `policy_record`.
    """
    record = policy_record(saved, results)
    return page_html([record], Start(record["environment"], record["embodiment"], (0,)))
