"""Resolution of an image, measured at the surface between the object and air."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..base.errors import InputError
from ..io.volumes import Volume
from .resolution import mtf_half, signed_distance_mm

SAMPLES = 5  # along each side, to locate the surface; odd
MOST_SLICES = 16  # evenly spaced slices that are used; their surfaces have thousands of voxels
SURFACE_HU = -500.0  # about halfway between air and soft tissue


def edge_mtf_half(image: Volume) -> float:
    """In-plane frequency (1/mm) at which the MTF, measured at an object's surface, is one half.

    The surface is where the linearly interpolated image crosses SURFACE_HU. A gradual surface counts as blur.

    Parameters
    ----------
    image : Volume
        HU, one object surrounded by air.

    Raises
    ------
    InputError
        If there is no such surface, or it is sharper than the voxels can show.
    """
    chosen = np.unique(np.linspace(0, len(image.array) - 1, MOST_SLICES).round().astype(int))
    planes = image.array[chosen]
    _, rows, columns = planes.shape
    y, x = (np.arange(size * SAMPLES) / SAMPLES - (SAMPLES - 1) / (2 * SAMPLES) for size in (rows, columns))
    positions = np.meshgrid(y, x, indexing="ij")
    fine = [ndimage.map_coordinates(plane, positions, order=1, mode="nearest") > SURFACE_HU for plane in planes]
    inside = np.stack([ndimage.binary_fill_holes(plane) for plane in fine])
    if not inside.any() or inside.all():
        raise InputError("public_scans: scans show no surface between object and air; set public_scans.own_blur: kept")
    distance = signed_distance_mm(inside, image.grid.spacing, SAMPLES)
    return mtf_half(planes[None], distance, image.grid.spacing, np.ones(planes.shape, bool)).value
