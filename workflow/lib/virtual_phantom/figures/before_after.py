"""Residual maps of one blind test before and after the diagnosis: a figure, and thumbnails for a gallery."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from .diagnosis import MapAxes, draw_maps

MAP_LIMIT = 6.0  # standard deviations; the color scale of thumbnails ends there
AXES = {"projections": ("detector column", "view"), "images": ("column", "row")}  # across, down


def draw(before: np.ndarray, after: np.ndarray, kind: str, hidden: str, found: str) -> Figure:
    """Draw residuals of held-out data in standard deviations, shape (down, across), on one color scale.

    The kind is "projections" or "images". The title names the hidden effects and those that the diagnosis found.
    """
    return draw_maps(before, after, f"hidden: {hidden}; found: {found}", MapAxes(*AXES[kind], kind == "images"))


def thumbnail(values: np.ndarray) -> bytes:
    """Return a residual map as a PNG image, one pixel per value, red and blue up to MAP_LIMIT."""
    steps = np.arange(256)
    palette = (255 * matplotlib.colormaps["RdBu_r"](steps)[:, :3]).round().astype(np.uint8)
    index = np.clip((values / MAP_LIMIT + 1) / 2, 0, 1) * steps[-1]
    image = Image.fromarray(index.round().astype(np.uint8), mode="P")
    image.putpalette(palette.ravel().tolist())
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
