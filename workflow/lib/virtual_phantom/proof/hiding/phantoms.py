"""Phantoms of the blind validation on fine voxels, as materials of XCIST."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...base.geometry import Grid
from ...base.streams import Stream
from ...io.volumes import Volume
from ...phantom import Phantom, Roi, layout, synthetic
from .objects import Object
from .xcist import Materials, attenuation_per_mm

LEAST_FRACTION = 1e-4  # smaller volume fractions are set to 0
FINER = 2  # subdivision of the known voxels in the scanned phantom
VOXELS_PER_PIXEL = 3  # known voxels per detector pixel at the isocenter
REACH = 1.3  # height of the cone beam at the phantom's far side over its height at the isocenter
# Additional height for detector rows that are displaced by up to 8 mm. Rays through the end faces would show a
# difference between the two simulators that is not an effect.
BEYOND_MM = 6.0


def build(scanned_object: Object, layout_file: str | Path, columns: int, rows: int, seed: Stream) -> Phantom:
    """Build a phantom, cut to the height that a detector of columns x rows sees.

    `fine` of the result is scanned, `image` is known to the diagnosis. The seed draws the textures.

    Raises
    ------
    InputError
        As synthetic.build.
    """
    pixel = scanned_object.pixel_mm(columns)
    voxel = pixel / VOXELS_PER_PIXEL
    slices, seen = (
        int(np.ceil(height / voxel / 2)) * 2
        for height in (scanned_object.least_mm, rows * pixel * REACH + 2 * BEYOND_MM)
    )
    across = (int(np.ceil(extent / voxel / 2)) * 2 for extent in scanned_object.extent_mm)
    grid = Grid((max(slices, seen), *across), (voxel,) * 3)
    whole = synthetic.build(layout.read_layout(layout_file), grid, FINER, seed)
    image = _middle(whole.image, seen)
    rois = [Roi(roi.name, roi.tissue_class, _middle(Volume(roi.mask, grid), seen).array) for roi in whole.rois]
    return Phantom(_middle(whole.fine, seen * FINER), image, tuple(roi for roi in rois if roi.mask.any()))


def _middle(volume: Volume, slices: int) -> Volume:
    first = (volume.grid.shape[0] - slices) // 2
    grid = Grid((slices, *volume.grid.shape[1:]), volume.grid.spacing)
    return Volume(np.ascontiguousarray(volume.array[first : first + slices]), grid)


def materials(hu: Volume, scanned_object: Object, kev: float, mu_water_per_mm: float) -> Materials:
    """Divide HU into materials whose attenuation at one energy is mu_water_per_mm (1 + HU / 1000) in every voxel.

    Voxels are square in the plane.
    """
    mu = np.maximum(mu_water_per_mm * (1 + hu.array.astype(np.float64) / 1000), 0)
    soft_mu, dense_mu = (attenuation_per_mm(name, kev) for name in (scanned_object.soft, scanned_object.dense))
    from_mu = mu_water_per_mm * (1 + scanned_object.dense_from_hu / 1000)
    dense = np.clip(mu - from_mu, 0, None) / (dense_mu - from_mu)  # a mixture by volume, up to all bone
    soft = (mu - dense * dense_mu) / soft_mu
    fractions = {scanned_object.soft: soft, scanned_object.dense: dense}
    for fraction in fractions.values():
        fraction[fraction < LEAST_FRACTION] = 0
    height, plane = hu.grid.spacing[:2]
    return Materials({name: part.astype(np.float32) for name, part in fractions.items()}, (plane, height))
