"""Regions for the comparison of images: grid, voxels with complete data, ROIs and the edge of the object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ...base.errors import InputError
from ...base.geometry import Grid, OrbitGeometry
from ...base.parallel_rays import ParallelRays
from ...base.units import HU_AIR, HU_BODY, attenuation_to_hu
from ...io.volumes import Volume, read_nifti
from ...phantom import read_masks
from ...physics.beam.materials import attenuation_per_mm, energy_of
from ...physics.scenes.labeled import LabelMap, read_label_map
from ...physics.scenes.objects import ShapedObject
from ...physics.scenes.scene import Pose, Scene
from ...physics.scenes.shapes import DiscScene
from ...physics.scenes.simulated import SimulatedScene
from ...physics.scenes.voxelized import reach_mm, roi_mask, shape_shares, shapes_to_hu
from ...projectors import projector
from ...reconstruction.fbp import fbp
from ...recordings.recording import Recording
from ...statistics.image_quality import LEAST_ROI_VOXELS
from ...statistics.resolution import signed_distance_mm
from ..request import DiagnosisRequest
from ..scanned_object import read_mask, shaped_object, simulated_slice
from ..settings import LabelledObject, ShapesObject
from .agreement import INNER_VOXELS, Regions

MOST_VOXELS, MOST_SLICES = 128, 8  # of reconstructed images; a choice that limits the run time
AIR_VOXELS = 8  # around the object, for its edge
SHAPES_FINER, SHAPES_ACROSS = 3, 300  # voxels of shapes per pixel at the isocenter, and most voxels across
PRISM_MM = 1000.0  # slice thickness of an object that is constant along z, larger than any beam height
SUBDIVIDED = 5  # samples of the edge per voxel and direction


@dataclass(frozen=True)
class ScannedVolume:
    """The scanned object as voxels, with its regions of interest.

    Attributes
    ----------
    fine : Volume
        HU, on the grid of the simulated object.
    rois : mapping of str to ndarray of bool, shape (z, y, x)
        By name, on `grid`.
    """

    fine: Volume
    rois: Mapping[str, np.ndarray]
    grid: Grid

    @classmethod
    def of(
        cls,
        request: DiagnosisRequest,
        recording: Recording,
        study_rois: tuple[str, str] | None = None,
        shape_rois: bool = True,
        scene: Scene | None = None,
    ) -> ScannedVolume | None:
        """Return the scanned object of a request; None for a disc, which needs no voxels.

        Parameters
        ----------
        study_rois : tuple of str, optional
            The study's image and its table of ROIs. Without it, the study's phantom has no ROIs.
        shape_rois : bool, optional
            Whether an object of shapes has its ROIs.
        scene : Scene, optional
            Scene of the request. Only the user's own simulation needs it.

        Raises
        ------
        InputError
            If a file is missing or invalid.
        """
        settings, mu_water_per_mm = request.settings, request.mu_water_per_mm
        if settings.disc is not None:
            return None
        if settings.of_scan or (settings.simulation is not None and recording.kind == "images"):
            simulated = simulated_slice(request)
            return cls._drawn(simulated.array.astype(np.float32), simulated.grid)
        if settings.simulation is not None:
            try:
                return cls.of_simulation(scene)
            except InputError:  # the comparison of images reports why the scan cannot be reconstructed
                return None
        if isinstance(settings.object, ShapesObject):
            shaped = shaped_object(settings.object)
            geometry = recording.geometry if request.protocol is None else request.protocol.geometry
            return cls.of_shapes(shaped if shape_rois else replace(shaped, rois=()), geometry, mu_water_per_mm)
        if isinstance(settings.object, LabelledObject):
            labelled = read_label_map(settings.object.labels, settings.object.materials)
            return cls.of_labels(labelled, mu_water_per_mm)
        if settings.object is not None:
            mask = read_mask(settings.object.mask)
            return cls._drawn(attenuation_to_hu(mask.array, 1.0), mask.grid)
        fine = read_nifti(request.phantom)
        if study_rois is None:
            return cls(fine, {}, fine.grid)
        image, rois_csv = study_rois
        grid = read_nifti(image).grid
        return cls(fine, read_masks(rois_csv, grid)[1], grid)

    @classmethod
    def of_labels(cls, labelled: LabelMap, mu_water_per_mm: float) -> ScannedVolume:
        """Return the object of a label map, without ROIs.

        Parameters
        ----------
        mu_water_per_mm : float
            Attenuation of water at the energy at which materials have their HU, 1/mm.
        """
        energy = energy_of("water", mu_water_per_mm)
        mu = np.array([attenuation_per_mm(material, [energy])[0] for material in labelled.materials], np.float32)
        return cls._drawn(attenuation_to_hu(np.tensordot(mu, labelled.shares, 1), mu_water_per_mm), labelled.grid)

    @classmethod
    def of_simulation(cls, scene: SimulatedScene) -> ScannedVolume:
        """Return the filtered back-projection of a simulation, without ROIs."""
        grid = image_grid(scene.geometry, scene.radius_mm)
        engine = projector("cpu", scene.geometry, grid, 1, scene.threads)
        water, *_ = scene.attenuation_per_mm
        lines = np.tensordot(scene.attenuation_per_mm / water, scene.paths_mm, 1)
        (image,) = fbp(engine, lines[None].astype(np.float32))
        return cls._drawn(attenuation_to_hu(image, 1.0), grid)

    @classmethod
    def _drawn(cls, hu: np.ndarray, grid: Grid) -> ScannedVolume:
        if grid.shape[0] == 1:  # constant along z: two slices, between whose centers nothing changes
            hu = np.repeat(hu, 2, axis=0)
            grid = Grid(hu.shape, (PRISM_MM, *grid.spacing[1:]))
        return cls(Volume(hu, grid), {}, grid)

    @classmethod
    def of_shapes(cls, shaped: ShapedObject, geometry: OrbitGeometry, mu_water_per_mm: float) -> ScannedVolume:
        """Return an object of shapes as voxels, within the field of view, with its ROIs.

        Parameters
        ----------
        mu_water_per_mm : float
            Attenuation of water at the energy at which shapes have their HU, 1/mm.
        """
        reach = min(reach_mm(shaped), geometry.field_of_view_radius_mm)
        row, column = (pitch / geometry.magnification for pitch in (geometry.row_pitch_mm, geometry.column_pitch_mm))
        voxel = max(column / SHAPES_FINER, 2 * reach / SHAPES_ACROSS)
        across = 2 * (int(np.ceil(reach / voxel)) + SHAPES_FINER)
        grid = Grid((max(geometry.rows, 2), across, across), (row, voxel, voxel))
        shares = shape_shares(shaped.shapes, grid)
        masks = {roi.name: roi_mask(roi, shares[shaped.names.index(roi.shape)], grid) for roi in shaped.rois}
        rois = {name: mask for name, mask in masks.items() if mask.any()}
        if geometry.rows == 1:  # one slice, at any height
            grid = Grid(grid.shape, (PRISM_MM, voxel, voxel))
        return cls(Volume(shapes_to_hu(shaped, shares, mu_water_per_mm), grid), rois, grid)

    @property
    def radius_mm(self) -> float:
        """Radius of the object about the axis, mm."""
        _, y, x = self.fine.grid.axes_mm()
        return float(np.hypot(y[:, None], x)[(self.fine.array > HU_BODY).any(axis=0)].max())


def image_grid(geometry: OrbitGeometry, radius_mm: float) -> Grid:
    """Return a grid of central slices around an object of this radius.

    Voxels have the size of detector pixels at the isocenter, or are larger to stay below MOST_VOXELS. Slices have the
    distance of detector rows, so that they share little noise.
    """
    reach = min(radius_mm, geometry.field_of_view_radius_mm)
    voxel = max(geometry.column_pitch_mm / geometry.magnification, 2 * reach / (MOST_VOXELS - 2 * AIR_VOXELS))
    # The projector needs a grid within the source orbit.
    most = min(MOST_VOXELS, int(np.sqrt(2) * geometry.source_to_isocentre_mm / voxel) - 1)
    across = min(most, int(np.ceil(2 * reach / voxel)) + 2 * AIR_VOXELS)
    height = geometry.row_pitch_mm / geometry.magnification
    slices = MOST_SLICES
    if not geometry.feed_per_rotation_mm:
        seen = (geometry.rows - 1) * (1 - reach / geometry.source_to_isocentre_mm)
        slices = min(slices, 1 + int(seen))
    return Grid((slices, across, across), (height, voxel, voxel))


def complete(geometry: OrbitGeometry, grid: Grid) -> np.ndarray:
    """Return the voxels that are seen from every direction.

    Raises
    ------
    InputError
        If there is no such voxel.
    """
    rays = ParallelRays(geometry)
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    valid = np.hypot(x, y) < geometry.field_of_view_radius_mm - grid.spacing[1]
    valid[valid] = rays.directions_seen(np.stack([x[valid], y[valid], z[valid]], axis=1)) == rays.half_turn
    if not valid.any():
        raise InputError("scan: no voxel around the isocenter is seen from every direction; images cannot be compared")
    return valid


def disc_regions(grid: Grid, valid: np.ndarray, disc: DiscScene, pose: Pose) -> Regions:
    """Return a disc and the air around it as regions."""
    _, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    distance = np.hypot(x - pose.x_mm, y - pose.y_mm) - disc.radius_mm * pose.size
    return Regions(grid.spacing, _object_and_air(distance, valid, grid), distance, valid)


def phantom_regions(grid: Grid, valid: np.ndarray, scanned: ScannedVolume, pose: Pose) -> Regions:
    """Return the parts of the object's ROIs in the images, or object and air if there are fewer than two.

    The edge is that between body and air.
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
    """Resample an object in its pose onto a grid.

    Parameters
    ----------
    of, at : Grid
        Grids of the object and of the result.
    """
    z, y, x = np.meshgrid(*at.axes_mm(), indexing="ij", sparse=True)
    x, y, z = x - pose.x_mm, y - pose.y_mm, z - pose.z_mm
    turn = np.deg2rad(pose.turn_deg)
    places = (z, np.cos(turn) * y - np.sin(turn) * x, np.cos(turn) * x + np.sin(turn) * y)
    index = [
        place / (pose.size * step) + (n - 1) / 2 for place, step, n in zip(places, of.spacing, of.shape, strict=True)
    ]
    return ndimage.map_coordinates(array, np.broadcast_arrays(*index), order=order, mode="constant", cval=outside)
