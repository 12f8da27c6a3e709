"""Viewer of the slices of the input, its reconstructions and their differences (viewer.html).

The HTML file contains the compressed voxels, and the browser draws them.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..base.names import label
from ..base.units import rounded_hu
from ..figures import axial, style
from ..io.volumes import Volume
from .html import render

# This viewer (150 lines and 12 kB of templates) keeps the page one file that works offline. NiiVue 0.69 would embed
# 2.9 MB of minified JavaScript in it and need WebGL 2. Differences, windows and outlines would still need own code.
MOST_BYTES = 10_500_000  # uncompressed voxels of a page; base64 text makes it at most 14 MB
MOST_ACROSS = 256  # voxels: longer rows and columns are thinned; otherwise slices are skipped


@dataclass(frozen=True)
class Reconstruction:
    """Reconstructions of one protocol, in HU on the phantom's grid: a single scan and the mean of all repeats."""

    title: str
    single: Volume
    mean: Volume
    repeats: int


def viewer_page(
    phantom: Volume,
    masks: Mapping[str, np.ndarray],
    reconstructions: Mapping[str, Reconstruction],
    subtitle: str,
) -> str:
    """Render the page as HTML.

    Parameters
    ----------
    phantom : Volume
        Input, HU.
    masks : mapping of str to ndarray, shape (z, y, x)
        ROIs, non-zero inside.
    reconstructions : mapping of str to Reconstruction
        {short key: reconstruction}.

    Raises
    ------
    InputError
        If a reconstruction is on another grid, or not finite.
    """
    volumes = {"input": phantom}
    for key, reconstruction in reconstructions.items():
        for part, volume in (("one", reconstruction.single), ("mean", reconstruction.mean)):
            if not volume.grid.matches(phantom.grid):
                raise InputError(
                    f"viewer, {reconstruction.title}: is on another grid than the phantom; reconstruct it again"
                )
            volumes[f"{key}_{part}"] = volume
    steps = thinning(phantom.grid.shape, len(volumes))
    labels = np.zeros(phantom.grid.shape, np.uint8)
    for number, mask in enumerate(masks.values(), start=1):
        labels[mask != 0] = number
    shape, spacing = displayed(labels, steps).shape, [s * n for s, n in zip(phantom.grid.spacing, steps, strict=True)]
    colors = style.assign(masks, style.ON_GRAY_IMAGE)
    content = {
        "shape": shape,
        "spacing": spacing,
        "first_slice": axial.choose_slices(masks)[0] // steps[0],
        "slices_mm": [round(axial.slice_z_mm(phantom.grid, z), 2) for z in range(0, phantom.grid.shape[0], steps[0])],
        "reconstructions": [
            {"key": key, "title": reconstruction.title, "repeats": reconstruction.repeats}
            for key, reconstruction in reconstructions.items()
        ],
        "rois": [{"name": label(name), "color": colors[name]} for name in masks],
    }
    return render(
        "viewer",
        {},
        content=content,
        subtitle=subtitle,
        packed={name: pack(displayed(hu_to_show(volume, name), steps)) for name, volume in volumes.items()}
        | {"rois": pack(displayed(labels, steps))},
        thinned=steps if max(steps) > 1 else None,
    )


def thinning(shape: tuple[int, int, int], volumes: int) -> tuple[int, int, int]:
    """Choose steps along z, y and x such that the thinned volumes (int16) fit into a page."""
    steps = [1, 1, 1]
    while 2 * volumes * np.prod([-(-n // step) for n, step in zip(shape, steps, strict=True)]) > MOST_BYTES:
        if max(shape[1] / steps[1], shape[2] / steps[2]) > MOST_ACROSS:
            steps[1:] = [steps[1] * 2, steps[2] * 2]
        else:
            steps[0] *= 2
    return tuple(steps)


def hu_to_show(volume: Volume, name: str) -> np.ndarray:
    """Return HU rounded to little-endian int16; InputError with `name` if a value is not finite."""
    rounded, _ = rounded_hu(volume.array, f"viewer, {name}: has values that are not finite; reconstruct it again")
    return rounded.astype("<i2")


def displayed(array: np.ndarray, steps: tuple[int, int, int]) -> np.ndarray:
    """Thin an array [z, y, x] and order rows from anterior to posterior, columns from the patient's right to left."""
    return array[:: steps[0], :: -steps[1], :: -steps[2]]


def pack(array: np.ndarray) -> str:
    """Compress an array to base64 text, the same text for equal arrays."""
    return base64.b64encode(gzip.compress(np.ascontiguousarray(array).tobytes(), mtime=0)).decode()
