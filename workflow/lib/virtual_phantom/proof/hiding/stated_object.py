"""Descriptions of the objects that the diagnosis gets: a CT in HU with ROIs, an object of shapes, and a label map.

All are of the stated object, without its errors. The diagnosis of a case uses one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
from scipy import ndimage

from ...base.geometry import Grid
from ...io.files import write_text
from ...io.volumes import Volume, write_nifti
from ...phantom import Phantom, Roi, write_phantom
from .materials import IN_LIBRARY, MATERIALS
from .objects import BODY, Part, ScannedObject
from .orbits import Orbit
from .voxels import grid_of, labels, stated_hu

LEAST_ROI_VOXELS, ROI_MARGIN_VOXELS = 60, 2


def write(folder: str | Path, scanned: ScannedObject, orbits: Sequence[Orbit]) -> None:
    """Write the stated object: of tissues as image.nii.gz with ROIs, others as object.yaml and labels.nii.gz."""
    folder = Path(folder)
    grid = grid_of(scanned, orbits)
    if scanned.kind == BODY:
        image = Volume(stated_hu(scanned, grid), grid)
        write_phantom(Phantom(image, image, tuple(_rois(scanned, grid))), folder)
        return
    write_text(yaml.safe_dump(described(scanned), sort_keys=False), folder / "object.yaml")
    plane = labels(scanned, grid)
    # A single slice states that the object is constant along z.
    if all(np.isinf(part.semi_axes_mm[2]) for part in scanned.parts):
        plane, grid = plane[:1], Grid((1, *grid.shape[1:]), grid.spacing)
    write_nifti(Volume(plane, grid), folder / "labels.nii.gz")


def described(scanned: ScannedObject) -> dict:
    """Return the content of a file of shapes."""
    own = {part.material for part in scanned.parts} - {*IN_LIBRARY, "air"}
    rois = [
        {"name": part.name, "tissue_class": part.name, "shape": part.name, "margin_mm": 2}
        for part in scanned.parts[1:]
        if part.material != "air" and part.radius_mm > 4
    ]
    return {
        "description": "An object of the blind validation.",
        "materials": {name: MATERIALS[name].stated() for name in sorted(own)},
        "shapes": [_shape(part) for part in scanned.parts],
        "rois": rois,
    }


def _shape(part: Part) -> dict:
    material = "nothing" if part.material == "air" else part.material
    shape = {"name": part.name, "material": material, "centre_mm": list(part.centre_mm)}
    if np.isinf(part.semi_axes_mm[2]):
        return shape | {"kind": "cylinder", "diameter_mm": 2 * part.semi_axes_mm[0]}
    return shape | {"kind": "ellipsoid", "semi_axes_mm": list(part.semi_axes_mm), "turn_deg": part.turn_deg}


def _rois(scanned: ScannedObject, grid: Grid) -> list[Roi]:
    """Return the inner voxels of each part."""
    parts, found = labels(scanned, grid), []
    for number, part in enumerate(scanned.parts, start=1):
        mask = ndimage.binary_erosion(parts == number, iterations=ROI_MARGIN_VOXELS, border_value=1)
        if part.material != "air" and mask.sum() >= LEAST_ROI_VOXELS:
            found.append(Roi(part.name, part.name, mask))
    return found
