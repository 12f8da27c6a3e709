"""What the proof scans, as XCIST takes it: the volume fractions of materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..volumes import Volume
from .xcist import Materials, attenuation_per_mm

LEAST_FRACTION = 1e-4  # below it a voxel is air, which is not scanned


@dataclass(frozen=True)
class Composition:
    """What a phantom is made of, in XCIST's materials: `soft`, its density following the HU, with `dense` mixed in from
    dense_from_hu on."""

    soft: str
    dense: str
    dense_from_hu: float


COMPOSITIONS = {
    "abdomen": Composition("ICRU_muscle_adult", "ICRU_skeleton_cortical_bone_adult", 150.0),
    "quality_assurance": Composition("water", "ICRU_skeleton_cortical_bone_adult", 150.0),
}


def materials(hu: Volume, composition: Composition, kev: float, mu_water_per_mm: float) -> Materials:
    """Divide HU so that a beam of one energy finds mu_water_per_mm (1 + HU / 1000) in every voxel.

    hu   float32 [z, y, x] with square voxels in the plane
    """
    mu = np.maximum(mu_water_per_mm * (1 + hu.array.astype(np.float64) / 1000), 0)
    soft_mu, dense_mu = (attenuation_per_mm(name, kev) for name in (composition.soft, composition.dense))
    from_mu = mu_water_per_mm * (1 + composition.dense_from_hu / 1000)
    dense = np.clip(mu - from_mu, 0, None) / (dense_mu - from_mu)  # a mixture by volume, up to all bone
    soft = (mu - dense * dense_mu) / soft_mu
    fractions = {composition.soft: soft, composition.dense: dense}
    for fraction in fractions.values():
        fraction[fraction < LEAST_FRACTION] = 0
    height, plane = hu.grid.spacing[:2]
    return Materials({name: one.astype(np.float32) for name, one in fractions.items()}, (plane, height))
