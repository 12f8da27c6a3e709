"""Where reconstructed images are compared: their grid, the voxels with complete data, ROIs and the object's edge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from ...base.errors import InputError
from ...base.geometry import Grid, OrbitGeometry
from ...base.parallel_rays import ParallelRays
from ...base.units import HU_AIR, HU_BODY, attenuation_to_hu
from ...io.volumes import Volume, read_nifti
from ...phantom import read_masks
from ...physics.beam.materials import attenuation_per_mm, energy_of
from ...physics.scenes.labeled import Labelled
from ...physics.scenes.objects import ShapedObject
from ...physics.scenes.scene import DiscScene, Pose
from ...physics.scenes.voxelized import hu_of, mask_of, reach_mm, share_of_each
from ...statistics.image_quality import LEAST_ROI_VOXELS
from ...statistics.resolution import signed_distance_mm
from ..scanned_object import read_mask
from .agreement import INNER_VOXELS, Regions

MOST_VOXELS, MOST_SLICES = 128, 8  # of images that are made for the comparison; a choice that bounds the time
AIR_VOXELS = 8  # around the object: what its edge needs
SHAPES_FINER, SHAPES_ACROSS = 3, 300  # voxels of shapes to a pixel at the isocentre; and at most so many across
PRISM_MM = 1000.0  # slice of an object that is alike along z: beyond any beam's height
SUBDIVIDED = 5  # samples per voxel and direction, of the edge


@dataclass(frozen=True)
class Scanned:
    """The study's phantom, or an object of shapes, of a label map or of a mask, if that was scanned.

    Attributes
    ----------
    fine : Volume
        HU, what projections were taken of.
    rois : mapping of str to ndarray of bool, shape (z, y, x)
        By name, on `grid`.
    """

    fine: Volume
    rois: Mapping[str, np.ndarray]
    grid: Grid

    @classmethod
    def read(cls, fine: str | Path, image: str | Path, rois_csv: str | Path) -> Scanned:
        """What the study's rule `phantom` wrote.

        Raises
        ------
        InputError
            As volumes.read_nifti and phantom.read_masks.
        """
        grid = read_nifti(image).grid
        return cls(read_nifti(fine), read_masks(rois_csv, grid)[1], grid)

    @classmethod
    def of_mask(cls, mask: str | Path) -> Scanned:
        """A homogeneous object: no ROIs but itself.

        Raises
        ------
        InputError
            As scanned.read_mask.
        """
        volume = read_mask(mask)
        return cls._drawn(attenuation_to_hu(volume.array, 1.0), volume.grid)

    @classmethod
    def of_labels(cls, labelled: Labelled, mu_water_per_mm: float) -> Scanned:
        """An object of a label map: no ROIs but itself.

        Parameters
        ----------
        mu_water_per_mm : float
            At the energy of which materials have their HU, 1/mm.
        """
        energy = energy_of("water", mu_water_per_mm)
        mu = np.array([attenuation_per_mm(one, [energy])[0] for one in labelled.materials], np.float32)
        return cls._drawn(attenuation_to_hu(np.tensordot(mu, labelled.shares, 1), mu_water_per_mm), labelled.grid)

    @classmethod
    def _drawn(cls, hu: np.ndarray, grid: Grid) -> Scanned:
        if grid.shape[0] == 1:  # alike along z: two slices, between whose centres nothing changes
            hu = np.repeat(hu, 2, axis=0)
            grid = Grid(hu.shape, (PRISM_MM, *grid.spacing[1:]))
        return cls(Volume(hu, grid), {}, grid)

    @classmethod
    def of_shapes(cls, shaped: ShapedObject, geometry: OrbitGeometry, mu_water_per_mm: float) -> Scanned:
        """An object of shapes as voxels, as far as a scan's beam sees it, and its regions.

        Parameters
        ----------
        mu_water_per_mm : float
            At the energy of which shapes have their HU, 1/mm.
        """
        reach = min(reach_mm(shaped), geometry.field_of_view_radius_mm)
        row, column = (pitch / geometry.magnification for pitch in (geometry.row_pitch_mm, geometry.column_pitch_mm))
        voxel = max(column / SHAPES_FINER, 2 * reach / SHAPES_ACROSS)
        across = 2 * (int(np.ceil(reach / voxel)) + SHAPES_FINER)
        grid = Grid((max(geometry.rows, 2), across, across), (row, voxel, voxel))
        shares = share_of_each(shaped.shapes, grid)
        masks = {roi.name: mask_of(roi, shares[shaped.names.index(roi.shape)], grid) for roi in shaped.rois}
        rois = {name: mask for name, mask in masks.items() if mask.any()}
        return cls(Volume(hu_of(shaped, shares, mu_water_per_mm), grid), rois, grid)

    @property
    def radius_mm(self) -> float:
        """How far from the isocentre's axis the object reaches, mm."""
        _, y, x = self.fine.grid.axes_mm()
        return float(np.hypot(y[:, None], x)[(self.fine.array > HU_BODY).any(axis=0)].max())


def image_grid(geometry: OrbitGeometry, radius_mm: float) -> Grid:
    """Central slices around an object of a radius.

    Voxels are as large as the detector's pixels at the isocentre, or larger where more than MOST_VOXELS of them would
    be needed. Slices lie a detector row apart, so that they share little noise, where views all around see them.

    Parameters
    ----------
    radius_mm : float
        mm.
    """
    reach = min(radius_mm, geometry.field_of_view_radius_mm)
    voxel = max(geometry.column_pitch_mm / geometry.magnification, 2 * reach / (MOST_VOXELS - 2 * AIR_VOXELS))
    # The projector asks for a grid within the source's orbit.
    most = min(MOST_VOXELS, int(np.sqrt(2) * geometry.source_to_isocentre_mm / voxel) - 1)
    across = min(most, int(np.ceil(2 * reach / voxel)) + 2 * AIR_VOXELS)
    height = geometry.row_pitch_mm / geometry.magnification
    slices = MOST_SLICES
    if not geometry.feed_per_rotation_mm:
        seen = (geometry.rows - 1) * (1 - reach / geometry.source_to_isocentre_mm)
        slices = min(slices, 1 + int(seen))
    return Grid((slices, across, across), (height, voxel, voxel))


def complete(geometry: OrbitGeometry, grid: Grid) -> np.ndarray:
    """Voxels that rays of every direction pass.

    Returns
    -------
    ndarray of bool, shape (z, y, x)

    Raises
    ------
    InputError
        As ParallelRays, or if there is no such voxel.
    """
    rays = ParallelRays(geometry)
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    valid = np.hypot(x, y) < geometry.field_of_view_radius_mm - grid.spacing[1]
    valid[valid] = rays.directions_seen(np.stack([x[valid], y[valid], z[valid]], axis=1)) == rays.half_turn
    if not valid.any():
        raise InputError("scan: no voxel around the isocentre is seen from every direction; images cannot be compared")
    return valid


def disc_regions(grid: Grid, valid: np.ndarray, disc: DiscScene, pose: Pose) -> Regions:
    """A disc and the air around it."""
    _, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    distance = np.hypot(x - pose.x_mm, y - pose.y_mm) - disc.radius_mm * pose.size
    return Regions(grid.spacing, _object_and_air(distance, valid, grid), distance, valid)


def phantom_regions(grid: Grid, valid: np.ndarray, scanned: Scanned, pose: Pose) -> Regions:
    """The ROIs of the study's phantom, those parts of them that the images show.

    Where the images show fewer than two, the object and the air around it. The edge is that of the body to air.

    Parameters
    ----------
    valid : ndarray of bool, shape (z, y, x)
        As Regions.valid.
    pose : Pose
        Of the object.
    """
    fine_shape = (grid.shape[0], *(n * SUBDIVIDED for n in grid.shape[1:]))
    fine = Grid(fine_shape, (grid.spacing[0], *(step / SUBDIVIDED for step in grid.spacing[1:])))
    body = sampled(scanned.fine.array, scanned.fine.grid, fine, pose, order=1, outside=HU_AIR) > HU_BODY
    distance = signed_distance_mm(body, grid.spacing, SUBDIVIDED)
    rois = {}
    for name, mask in scanned.rois.items():
        shown = (sampled(mask.astype(np.uint8), scanned.grid, grid, pose, order=0, outside=0) > 0) & valid
        if shown.sum() >= LEAST_ROI_VOXELS:
            rois[name] = shown
    return Regions(grid.spacing, rois if len(rois) > 1 else _object_and_air(distance, valid, grid), distance, valid)


def _object_and_air(distance_mm: np.ndarray, valid: np.ndarray, grid: Grid) -> dict[str, np.ndarray]:
    margin = INNER_VOXELS * grid.spacing[1]
    return {"object": valid & (distance_mm < -margin), "air": valid & (distance_mm > margin)}


def sampled(array: np.ndarray, of: Grid, at: Grid, pose: Pose, order: int, outside: float) -> np.ndarray:
    """What lies at the voxels of a grid once the object has its pose.

    Parameters
    ----------
    array : ndarray, shape (z, y, x)
        The object.
    of, at : Grid
        The object's, and the one asked for.
    order : int
        Of the interpolation.
    outside : float
        What lies there.

    Returns
    -------
    ndarray
        Shaped as `at`.
    """
    z, y, x = np.meshgrid(*at.axes_mm(), indexing="ij", sparse=True)
    x, y, z = x - pose.x_mm, y - pose.y_mm, z - pose.z_mm
    turn = np.deg2rad(pose.turn_deg)
    places = (z, np.cos(turn) * y - np.sin(turn) * x, np.cos(turn) * x + np.sin(turn) * y)
    index = [
        place / (pose.size * step) + (n - 1) / 2 for place, step, n in zip(places, of.spacing, of.shape, strict=True)
    ]
    return ndimage.map_coordinates(array, np.broadcast_arrays(*index), order=order, mode="constant", cval=outside)
