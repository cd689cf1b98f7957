"""Encoding of animated GIFs."""

import io
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from PIL import Image

SHADES, HUES = 192, 63
"""Numbers of palette colours besides white: for large areas (the sky), and small details (a red hand)."""

SAMPLED = 12
"""Largest number of frames from which the palette is computed."""


def gif_bytes(frames: Sequence[NDArray[np.uint8]], seconds: float | Fraction, pause: float = 0.0) -> bytes:
    """Return a looping GIF whose frames share one palette, so that static areas do not flicker.

    Args:
        frames: RGB images (height, width, 3), all of the same size.
        seconds: duration of a frame.
        pause: further duration of the last frame, seconds.
    """
    sampled = np.linspace(0, len(frames) - 1, min(SAMPLED, len(frames))).round().astype(int)
    mosaic = Image.fromarray(np.concatenate([frames[index] for index in sampled]))
    shades = _colours(mosaic, SHADES, Image.Quantize.MEDIANCUT)
    colours = [255, 255, 255, *shades, *_colours(mosaic, HUES, Image.Quantize.MAXCOVERAGE)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours)
    pictures = []
    for frame in frames:
        indices = np.array(Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        indices[(frame == 255).all(axis=2)] = 0  # exact white, which Pillow only approximates
        pictures.append(Image.fromarray(indices, "P"))
        pictures[-1].putpalette(colours)
    # GIFs count time in 1/100 s, and viewers slow down frames shorter than 1/50 s
    milliseconds = max(20, round(100 * seconds) * 10)
    durations = [*[milliseconds] * (len(pictures) - 1), milliseconds + round(1000 * pause)]
    buffer = io.BytesIO()
    pictures[0].save(
        buffer, "GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, disposal=1
    )
    return buffer.getvalue()


def _colours(picture: Image.Image, count: int, method: Image.Quantize) -> list[int]:
    """Return a palette of `count` colours for a picture, as a flat list of RGB values."""
    values = picture.quantize(count, method=method).getpalette() or []
    return (values + [0] * 3 * count)[: 3 * count]
