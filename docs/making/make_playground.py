"""Build the playground: the engine from pinned sources, the page of the site, the animation of the README.

python docs/making/make_playground.py results --task 0.6,4

Needs the PyPI package ziglang in the version given in `engine_building`, and Chromium for the
film. Describes the built files in docs/playground/built.json, which a test compares with the files.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import shutil
from importlib.metadata import version
from pathlib import Path

from engine_building import ZIG, build, kernels_in_c
from PIL import Image
from playwright.sync_api import sync_playwright

from analysis.names import label
from tma_ray.embodiments import embodiment_names
from tma_ray.playground.contents import variants
from tma_ray.playground.page import WASM, Start, page_html, policy_record
from tma_ray.results import Results
from tma_ray.runs.checkpoints import find_policy

ROOT = Path(__file__).parents[2]

FILM_SIZE, FRAMES, FRAME_STEPS, FRAME_MILLISECONDS, COLOURS = (640, 240), 90, 5, 100, 32
"""Width and height in pixels, frames, steps and milliseconds of a frame, and colours of the film."""


def digest(content: bytes) -> str:
    """Return the SHA-256 of `content`."""
    return hashlib.sha256(content).hexdigest()


def page(root: str, task: tuple[float, ...], seed: int) -> tuple[str, list[str]]:
    """Return the HTML page with the policies of a results root, and the ids of their runs."""
    records = []
    for manifest in Results.open(root).runs():
        saved = find_policy(manifest.run.run_id, root)
        records.append(policy_record(saved, root) | {"label": label(saved.spec.teacher)})
    start = Start(policies=tuple(range(min(len(records), 4))), task=task, seed=seed)
    names = [variant for name in embodiment_names() for variant in variants(name)]
    return page_html(records, start, names), [record["name"] for record in records]


def film(file: Path, output: Path) -> None:
    """Write an animation of the first seconds of a page, without its controls."""
    frames = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": FILM_SIZE[0], "height": FILM_SIZE[1]})
        shown.goto(file.as_uri())
        shown.wait_for_function("window.playground")
        style = f"position: fixed; inset: 0; width: {FILM_SIZE[0]}px; height: {FILM_SIZE[1]}px; min-height: 0"
        shown.evaluate(f"playground.set('playing', false); playground.restart(); world.style = '{style}'")
        for name in ("sky-top", "sky-bottom"):  # a plain sky halves the size of the file
            shown.evaluate(f"document.documentElement.style.setProperty('--{name}', '#d9e8f3')")
        shown.evaluate("shades.clear()")
        for _ in range(FRAMES):
            shown.evaluate(
                f"for (let k = 0; k < {FRAME_STEPS}; k++) playground.runners.forEach((each) => each.step())"
            )
            shown.evaluate("new Promise(requestAnimationFrame)")
            frames.append(Image.open(io.BytesIO(shown.screenshot())).convert("RGB"))
        browser.close()
    colours = frames[len(frames) // 2].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=2)
    first, *others = (frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames)
    first.save(
        output, save_all=True, append_images=others, duration=FRAME_MILLISECONDS, loop=0, optimize=True
    )


def main() -> None:
    """Build engine, page and animation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", help="results root with the policies that the page has")
    parser.add_argument("--task", default="0.6,4", help="task that the page plays first")
    parser.add_argument("--seed", type=int, default=3, help="seed of the world that the page plays first")
    parser.add_argument("--munk", type=Path, help="folder of Chipmunk's sources, if not downloaded")
    options = parser.parse_args()
    WASM.write_bytes(build(options.munk))
    text, runs = page(options.root, tuple(map(float, options.task.split(","))), options.seed)
    file = ROOT / "docs/playground/index.html"
    file.parent.mkdir(exist_ok=True)
    file.write_text(text, encoding="utf-8")
    built = {
        "sources": {
            "pymunk": version("pymunk"),
            "ziglang": ZIG,
            "kernels_sha256": digest(kernels_in_c().encode()),
        },
        "engine": {"bytes": WASM.stat().st_size, "sha256": digest(WASM.read_bytes())},
        "page": {"bytes": file.stat().st_size, "sha256": digest(file.read_bytes()), "policies": runs},
    }
    (file.parent / "built.json").write_text(json.dumps(built, indent=1) + "\n")
    film(file, ROOT / "docs/images/playground.gif")


if __name__ == "__main__":
    main()
