"""The phantoms of the proof, finer than the diagnosis sees them, as XCIST takes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...base.geometry import Grid
from ...base.streams import Stream
from ...io.volumes import Volume
from ...phantom import Phantom, Roi, layout, synthetic
from .objects import Object
from .xcist import Materials, attenuation_per_mm

LEAST_FRACTION = 1e-4  # below it a voxel is air, which is not scanned
FINER = 2  # voxels of the scanned phantom over those that the diagnosis is given
VOXELS_PER_PIXEL = 3  # that the diagnosis is given, at the isocentre
REACH = 1.3  # of the beam's height at the isocentre: what its cone sees of the phantom's near and far side
# Beyond it, mm: what rows that lie up to 8 mm off see of the far side. Where rays leave through the ends, two
# simulators differ by how they end an object, which no effect is.
BEYOND_MM = 6.0


def build(one: Object, layout_file: str | Path, columns: int, rows: int, seed: Stream) -> Phantom:
    """The phantom cut to the height that a detector of columns x rows sees: `fine` is scanned, `image` is known.

    Parameters
    ----------
    seed : Stream
        Of the textures.

    Raises
    ------
    InputError
        As synthetic.build.
    """
    pixel = one.pixel_mm(columns)
    voxel = pixel / VOXELS_PER_PIXEL
    slices, seen = (
        int(np.ceil(height / voxel / 2)) * 2 for height in (one.least_mm, rows * pixel * REACH + 2 * BEYOND_MM)
    )
    across = (int(np.ceil(extent / voxel / 2)) * 2 for extent in one.extent_mm)
    grid = Grid((max(slices, seen), *across), (voxel,) * 3)
    whole = synthetic.build(layout.read_layout(layout_file), grid, FINER, seed)
    image = _middle(whole.image, seen)
    rois = [Roi(roi.name, roi.tissue_class, _middle(Volume(roi.mask, grid), seen).array) for roi in whole.rois]
    return Phantom(_middle(whole.fine, seen * FINER), image, tuple(roi for roi in rois if roi.mask.any()))


def _middle(volume: Volume, slices: int) -> Volume:
    first = (volume.grid.shape[0] - slices) // 2
    grid = Grid((slices, *volume.grid.shape[1:]), volume.grid.spacing)
    return Volume(np.ascontiguousarray(volume.array[first : first + slices]), grid)


def materials(hu: Volume, one: Object, kev: float, mu_water_per_mm: float) -> Materials:
    """Divide HU so that a beam of one energy finds mu_water_per_mm (1 + HU / 1000) in every voxel.

    Parameters
    ----------
    hu : Volume
        float32, with square voxels in the plane.
    kev : float
        Energy of the beam, keV.
    mu_water_per_mm : float
        1/mm.
    """
    mu = np.maximum(mu_water_per_mm * (1 + hu.array.astype(np.float64) / 1000), 0)
    soft_mu, dense_mu = (attenuation_per_mm(name, kev) for name in (one.soft, one.dense))
    from_mu = mu_water_per_mm * (1 + one.dense_from_hu / 1000)
    dense = np.clip(mu - from_mu, 0, None) / (dense_mu - from_mu)  # a mixture by volume, up to all bone
    soft = (mu - dense * dense_mu) / soft_mu
    fractions = {one.soft: soft, one.dense: dense}
    for fraction in fractions.values():
        fraction[fraction < LEAST_FRACTION] = 0
    height, plane = hu.grid.spacing[:2]
    return Materials({name: part.astype(np.float32) for name, part in fractions.items()}, (plane, height))
