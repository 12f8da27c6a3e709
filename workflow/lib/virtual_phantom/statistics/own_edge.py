"""Resolution of one image from the surface of the object in it against air."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..base.errors import InputError
from ..io.volumes import Volume
from .resolution import mtf_half, signed_distance_mm

FINER = 5  # samples of a voxel's side at which the surface is found; odd
MOST_SLICES = 16  # evenly chosen: their surfaces have thousands of voxels
SURFACE_HU = -500.0  # about half-way between air and soft tissue


def edge_mtf_half(image: Volume) -> float:
    """Frequency in the plane at which the MTF of an object's surface is one half.

    The surface is where the image, interpolated linearly, crosses SURFACE_HU. One that is not sharp itself counts as
    blur.

    Parameters
    ----------
    image : Volume
        HU, of one object with air around it.

    Returns
    -------
    float
        1/mm.

    Raises
    ------
    InputError
        If there is no such surface, or it is sharper than the voxels show.
    """
    chosen = np.unique(np.linspace(0, len(image.array) - 1, MOST_SLICES).round().astype(int))
    planes = image.array[chosen]
    _, rows, columns = planes.shape
    y, x = (np.arange(size * FINER) / FINER - (FINER - 1) / (2 * FINER) for size in (rows, columns))
    places = np.meshgrid(y, x, indexing="ij")
    fine = [ndimage.map_coordinates(plane, places, order=1, mode="nearest") > SURFACE_HU for plane in planes]
    inside = np.stack([ndimage.binary_fill_holes(one) for one in fine])
    if not inside.any() or inside.all():
        raise InputError("own blur: the scans show no surface against air; set public_scans.own_blur: kept")
    distance = signed_distance_mm(inside, image.grid.spacing, FINER)
    return mtf_half(planes[None], distance, image.grid.spacing, np.ones(planes.shape, bool)).value
