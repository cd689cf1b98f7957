"""Frames as files: .mp4 through PyAV, .gif and .png through Pillow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Frame = NDArray[np.uint8]
"""One picture (height, width, 3), red, green and blue."""

SHADES, HUES = 192, 64
"""Colours that all frames of a .gif share: such as many pixels have, as in a sky, and such as differ most,
as that of a red hand."""

PALETTE_FRAMES = 12
"""From how many frames, evenly spaced, those colours are chosen."""

QUALITY = 20
"""x264's constant rate factor: 0 is lossless, 51 worst."""


def check_picture(path: Path) -> None:
    """Refuses a file that `write_frames` could not draw_text.

    Raises:
        ValueError: another ending than .mp4, .gif and .png, no such folder or one that cannot be written
            to, or an .mp4 without PyAV.
    """
    folder = path.absolute().parent
    if path.suffix not in _WRITERS:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(_WRITERS)}")
    if not folder.is_dir():
        raise ValueError(f"{path}: the folder {folder} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK) or path.is_dir():
        raise ValueError(f"{path}: cannot be written; choose another folder or name")
    if path.suffix == ".mp4":
        try:
            import av  # noqa: F401
        except ImportError as error:
            raise ValueError(
                f"{path}: an .mp4 needs PyAV: pip install 'tma_ray[render]', or choose .gif or .png"
            ) from error


def write_frames(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    """Writes `frames`, at least one and all of one size, in the format that `path` ends in.

    A .png holds the last frame alone; of a .gif all frames are held in memory. The file appears when it is
    complete.

    Raises:
        ValueError: as `check_picture` does.
    """
    check_picture(path)
    unfinished = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        _WRITERS[path.suffix](unfinished, frames, frames_per_second)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _write_mp4(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = None
        for frame in frames:
            even = frame[: len(frame) // 2 * 2, : frame.shape[1] // 2 * 2]  # H.264 halves its colours' sizes
            if stream is None:
                stream = container.add_stream("libx264", rate=frames_per_second)
                stream.height, stream.width = even.shape[:2]
                stream.pix_fmt, stream.options = "yuv420p", {"crf": str(QUALITY)}
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(even), "rgb24")))
        assert stream is not None
        container.mux(stream.encode(None))


def _write_gif(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    kept = list(frames)
    chosen = np.linspace(0, len(kept) - 1, min(PALETTE_FRAMES, len(kept))).round().astype(int)
    mosaic = Image.fromarray(np.concatenate([kept[index] for index in chosen]))
    palette = Image.new("P", (1, 1))
    palette.putpalette(
        _colours(mosaic, SHADES, Image.Quantize.MEDIANCUT)
        + _colours(mosaic, HUES, Image.Quantize.MAXCOVERAGE)
    )
    first, *others = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in kept
    )
    milliseconds = max(20, round(100 / frames_per_second) * 10)  # the format counts in 1/100 s
    first.save(path, save_all=True, append_images=others, duration=milliseconds, loop=0, disposal=1)


def _colours(picture: Image.Image, count: int, method: Image.Quantize) -> list[int]:
    """Returns `count` colours of `picture`, one value after the other."""
    values = picture.quantize(count, method=method).getpalette() or []
    return (values + [0] * 3 * count)[: 3 * count]


def _write_png(path: Path, frames: Iterable[Frame], _frames_per_second: Fraction) -> None:
    *_, last = frames
    Image.fromarray(last).save(path, optimize=True)


_WRITERS: dict[str, Callable[[Path, Iterable[Frame], Fraction], None]] = {
    ".mp4": _write_mp4,
    ".gif": _write_gif,
    ".png": _write_png,
}
