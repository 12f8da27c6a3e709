"""One concealed case before and after: a figure, and thumbnails for a gallery."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from .diagnosis import MAP_LIMIT, draw_maps

AXES = {"projections": ("detector column", "view"), "images": ("column", "row")}  # across, down


def draw(before: np.ndarray, after: np.ndarray, kind: str, concealed: str, named: str) -> Figure:
    """Standardised residuals of data not fitted, before and after, on one scale.

    Parameters
    ----------
    before, after : ndarray, shape (down, across)
        Standard deviations.
    kind : {"projections", "images"}
    concealed, named : str
        In words, for the title.
    """
    title = f"concealed: {concealed}   –   named: {named}"
    return draw_maps(before, after, title, *AXES[kind], image=kind == "images")


def thumbnail(values: np.ndarray) -> bytes:
    """The map as PNG, a pixel each, on the scale and with the colours of `draw`."""
    steps = np.arange(256)
    palette = (255 * matplotlib.colormaps["RdBu_r"](steps)[:, :3]).round().astype(np.uint8)
    index = np.clip((values / MAP_LIMIT + 1) / 2, 0, 1) * steps[-1]
    image = Image.fromarray(index.round().astype(np.uint8), mode="P")
    image.putpalette(palette.ravel().tolist())
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
