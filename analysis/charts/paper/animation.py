"""Charts in motion: a GIF whose frames are the moments of a chart's panels."""

import io
from collections.abc import Iterator

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from analysis.charts.base import Chart, spread
from analysis.charts.paper.drawing import lay_out
from analysis.charts.paper.marks import draw_marks
from analysis.charts.paper.style import styled
from analysis.formatting import amount

DPI = 90
"""Resolution of an animation, in dots per inch."""

COLOURS = 128
"""Colours of all frames of an animation together."""


@styled
def animate(chart: Chart, seconds: float = 6.0) -> bytes:
    """Return a chart as a GIF that repeats, a frame for each moment of its first panel.

    Args:
        chart: chart whose panels all have the same moments.
        seconds: length of the whole; the last frame stays for another second.
    """
    images = list(_images(chart))
    # All frames share their colours, so that still parts do not flicker.
    few = [images[index] for index in spread(len(images), 5)]
    width, height = few[0].size
    sheet = Image.new("RGB", (width, height * len(few)))
    for place, image in enumerate(few):
        sheet.paste(image, (0, place * height))
    colours = sheet.quantize(COLOURS - 1, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([255, 255, 255, *colours[: 3 * (COLOURS - 1)]])
    pictures = []
    for image in images:
        found = image.quantize(palette=palette, dither=Image.Dither.NONE)
        places = np.array(found)
        places[(np.asarray(image) == 255).all(axis=2)] = 0  # white, to which Pillow only comes near
        pictures.append(Image.fromarray(places, "P"))
        pictures[-1].putpalette(found.getpalette() or [])
    # GIF counts hundredths of a second, and viewers slow down what is faster than two of them.
    pause = max(20, round(1000 * seconds / len(pictures) / 10) * 10)
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[*[pause] * (len(pictures) - 1), pause + 1000],
        loop=0,
        optimize=False,
    )
    return buffer.getvalue()


def _images(chart: Chart) -> Iterator[Image.Image]:
    figure, drawn = lay_out(chart)
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    for step in chart.all_panels[0].moments:
        for panel, axes in drawn.items():
            for artist in (*axes.collections, *axes.patches, *axes.texts):
                artist.remove()
            draw_marks(axes, panel.at(step))
        figure.suptitle(f"{amount(step)} steps" if step else "start", fontsize=9)
        canvas.draw()  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # panels stay where the first frame has them
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        yield Image.fromarray(pixels[..., :3])
