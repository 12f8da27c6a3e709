"""How differences of images are looked at."""

from __future__ import annotations

import numpy as np

from ..core.look import Look
from .locate import locate
from .model import scaled


def _hu(prepared, fit, held_out: bool) -> np.ndarray:
    data = prepared.held_out if held_out else prepared.data
    mean = prepared.fitter.model.images(fit.physics, fit.nuisance)[0]
    return (data.hu - scaled(mean, fit.nuisance))[data.usable]


IMAGES = Look(
    places=locate,
    difference=_hu,
    unit="hu",
    summed=0,
    down="row",
    across="column",
    profiles=(
        ("distance from the axis", "ring around the isocentre", 1),
        ("slices", "slice", 0),
        ("tissue", "HU (tenth of the object)", 1),
    ),
    one_repeat="is that of the repeats held out, if there are two, else of simulated scans, scaled to what changes "
    "from voxel to voxel in the recording",
)
