"""A page to flip through the slices of the input, its reconstructions and what they differ by.

One HTML file with the voxels inside, compressed; the browser unpacks and draws them. Windows, slices and differences
are chosen there.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..base.units import whole_hu
from ..base.words import label
from ..figures import axial, style
from ..io.volumes import Volume
from .html import render

MOST_BYTES = 10_500_000  # of voxels; as text in a page, at worst, a third more: 14 MB
MOST_ACROSS = 256  # larger slices are thinned before slices are left out


@dataclass(frozen=True)
class Reconstruction:
    """What a page shows of one protocol, HU on the phantom's grid.

    Attributes
    ----------
    one : Volume
        A single scan.
    mean : Volume
        The mean of `repeats` scans.
    """

    title: str
    one: Volume
    mean: Volume
    repeats: int


def page(
    phantom: Volume,
    masks: Mapping[str, np.ndarray],
    reconstructions: Mapping[str, Reconstruction],
    subtitle: str,
) -> str:
    """The page as HTML.

    Parameters
    ----------
    phantom : Volume
        HU, the input.
    masks : mapping of str to ndarray, shape (z, y, x)
        ROIs by name, non-zero inside.
    reconstructions : mapping of str to Reconstruction
        By a short key.

    Raises
    ------
    InputError
        If a reconstruction is on another grid, or not finite.
    """
    volumes = {"input": phantom}
    for key, reconstruction in reconstructions.items():
        for part, volume in (("one", reconstruction.one), ("mean", reconstruction.mean)):
            if not volume.grid.matches(phantom.grid):
                raise InputError(f"viewer, {reconstruction.title}: is on another grid than the phantom")
            volumes[f"{key}_{part}"] = volume
    steps = thinning(phantom.grid.shape, len(volumes))
    labels = np.zeros(phantom.grid.shape, np.uint8)
    for number, mask in enumerate(masks.values(), start=1):
        labels[mask != 0] = number
    shape, spacing = shown(labels, steps).shape, [s * n for s, n in zip(phantom.grid.spacing, steps, strict=True)]
    first = axial.choose_slices(masks)[0] // steps[0]
    colours = style.assign(masks, style.ON_GREY_IMAGE)
    content = {
        "shape": shape,
        "spacing": spacing,
        "first_slice": first,
        "slices_mm": [round(axial.slice_z_mm(phantom.grid, z), 2) for z in range(0, phantom.grid.shape[0], steps[0])],
        "reconstructions": [
            {"key": key, "title": one.title, "repeats": one.repeats} for key, one in reconstructions.items()
        ],
        "rois": [{"name": label(name), "colour": colours[name]} for name in masks],
    }
    return render(
        "viewer",
        {},
        content=content,
        subtitle=subtitle,
        packed={name: pack(shown(hu_to_show(volume, name), steps)) for name, volume in volumes.items()}
        | {"rois": pack(shown(labels, steps))},
        thinned=steps if max(steps) > 1 else None,
    )


def thinning(shape: tuple[int, int, int], volumes: int) -> tuple[int, int, int]:
    """Steps along z, y and x at which voxels are kept, so that this many volumes of int16 fit into a page."""
    steps = [1, 1, 1]
    while 2 * volumes * np.prod([-(-n // step) for n, step in zip(shape, steps, strict=True)]) > MOST_BYTES:
        if max(shape[1] / steps[1], shape[2] / steps[2]) > MOST_ACROSS:
            steps[1:] = [steps[1] * 2, steps[2] * 2]
        else:
            steps[0] *= 2
    return tuple(steps)


def hu_to_show(volume: Volume, name: str) -> np.ndarray:
    """Whole HU, int16 with the low byte first.

    Parameters
    ----------
    name : str
        What the message calls it.

    Returns
    -------
    ndarray of int16, shape (z, y, x)

    Raises
    ------
    InputError
        If it is not finite.
    """
    whole, _ = whole_hu(volume.array, f"viewer, {name}: holds values that are not finite; reconstruct it again")
    return whole.astype("<i2")


def shown(array: np.ndarray, steps: tuple[int, int, int]) -> np.ndarray:
    """What a page holds of an array [z, y, x]: thinned, rows to posterior, columns to the patient's left."""
    return array[:: steps[0], :: -steps[1], :: -steps[2]]


def pack(array: np.ndarray) -> str:
    """The array's bytes, compressed, as text. Equal arrays make equal text."""
    return base64.b64encode(gzip.compress(np.ascontiguousarray(array).tobytes(), mtime=0)).decode()
