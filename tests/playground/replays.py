"""Replay of episodes of Python's engine in the page's engine, in node and in Chromium.

Tests are skipped if a program is missing.
"""

import base64
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from engine_building import C_SOURCES
from playwright.sync_api import Browser

from tma_ray.playground.page import SCRIPTS, SOURCES, WASM

HERE = Path(__file__).parent


def sine_of_the_page(place: Path) -> dict[str, str]:
    """Return environment variables that give Python's engine the page's sine and cosine."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("a C compiler on Linux gives Python's engine the page's sine and cosine")
    library = place / "sine.so"
    flags = ["-O2", "-shared", "-fPIC", "-ffp-contract=off", "-fno-builtin"]
    subprocess.run([compiler, *flags, "-o", str(library), str(C_SOURCES / "sine.c")], check=True)
    return {"LD_PRELOAD": str(library)}


def recorded(
    place: Path, count: int, steps: int, bodies: tuple[str, ...], sine: dict[str, str]
) -> list[Path]:
    """Record episodes to `place`; return a file per body and environment."""
    command = [sys.executable, str(HERE / "episodes.py"), str(place), str(count), str(steps), *bodies]
    subprocess.run(command, env=os.environ | sine, check=True)
    return sorted(place.glob("*.json"))


def scripts_of_the_page() -> str:
    """Return the page's scripts without its controls."""
    return "".join((SOURCES / name).read_text() for name in SCRIPTS[:2])


def in_node(place: Path, *files: Path) -> list[Any]:
    """Return the results of `replay.js` in node, by file."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node")
    scripts = place / "scripts.js"
    scripts.write_text(scripts_of_the_page())
    command = [node, str(HERE / "replay.js"), str(scripts), str(WASM), *map(str, files)]
    made = subprocess.run(command, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in made.stdout.splitlines()]


def in_chromium(browser: Browser, *files: Path) -> list[Any]:
    """Return the results of `replay.js` in Chromium, by file."""
    page = browser.new_page()
    page.add_script_tag(content=scripts_of_the_page() + (HERE / "replay.js").read_text())
    page.evaluate(
        "async (text) => { window.module = await WebAssembly.compile(Uint8Array.from(atob(text), "
        "(letter) => letter.charCodeAt(0))); }",
        base64.b64encode(WASM.read_bytes()).decode(),
    )
    call = "(text) => replay(Engine, window.module, JSON.parse(text))"
    found = [page.evaluate(call, file.read_text()) for file in files]
    page.close()
    return found
