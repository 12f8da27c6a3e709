"""Residual maps of one blind test before and after the diagnosis: a figure, and thumbnails for a gallery."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from .diagnosis import MAP_LIMIT, draw_maps

AXES = {"projections": ("detector column", "view"), "images": ("column", "row")}  # across, down


def draw(before: np.ndarray, after: np.ndarray, kind: str, hidden: str, found: str) -> Figure:
    """Draw the standardized residuals of held-out data, before and after the diagnosis, on one color scale.

    Parameters
    ----------
    before, after : ndarray, shape (down, across)
        Residuals in standard deviations.
    kind : {"projections", "images"}
    hidden, found : str
        Names of the hidden effects and of the effects that the diagnosis found, for the title.
    """
    title = f"hidden: {hidden}, found: {found}"
    return draw_maps(before, after, title, *AXES[kind], image=kind == "images")


def thumbnail(values: np.ndarray) -> bytes:
    """Return a residual map as a PNG image, one pixel per value, with the color scale of `draw`."""
    steps = np.arange(256)
    palette = (255 * matplotlib.colormaps["RdBu_r"](steps)[:, :3]).round().astype(np.uint8)
    index = np.clip((values / MAP_LIMIT + 1) / 2, 0, 1) * steps[-1]
    image = Image.fromarray(index.round().astype(np.uint8), mode="P")
    image.putpalette(palette.ravel().tolist())
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
